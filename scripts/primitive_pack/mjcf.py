"""MJCF models of boxes, cylinders and capsules, laid out as LIBERO and robosuite read them.

Lengths are metres, angles radians, quaternions (w, x, y, z). A `solid` is felt and not seen (group 0), a `look` is seen
and not felt (group 1); robosuite hides group 0 in pictures and counts only the mass of group 0. Their common attributes
stand once in each file, as the classes `solid` and `look`.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

Vector = Sequence[float]

GRIPPY = {"friction": "0.95 0.3 0.1", "solref": "0.001 1", "solimp": "0.998 0.998 0.001"}
"""Contacts of LIBERO's objects, measured: high friction, hard and critically damped."""


class Model:
    """One XML file of a pack."""

    def __init__(self, path: str, about: str, **solid: str) -> None:
        self.path = path
        self.root = ET.Element("mujoco", model=Path(path).stem)
        self.root.append(ET.Comment(f" {about} Written by scripts/primitive_pack. "))
        defaults = ET.SubElement(self.root, "default")
        self.solid = ET.SubElement(ET.SubElement(defaults, "default", {"class": "solid"}), "geom", group="0", **solid)
        look = ET.SubElement(defaults, "default", {"class": "look"})
        ET.SubElement(look, "geom", group="1", contype="0", conaffinity="0", mass="0")
        self.world = Part(ET.SubElement(self.root, "worldbody"))

    def write(self, folder: Path) -> None:
        path = folder / self.path
        path.parent.mkdir(parents=True, exist_ok=True)
        ET.indent(self.root)
        path.write_text(ET.tostring(self.root, encoding="unicode") + "\n", encoding="utf-8")


class Thing(Model):
    """An object or a fixture: a body `object`, and the sites by which LIBERO places it, all in one outer body.

    `bottom` and `top` are heights of the object's ends, `radius` its horizontal extent: LIBERO's own numbers, which
    decide where an object is put at a reset, whatever its true size.
    """

    def __init__(
        self, path: str, about: str, *, mass: float, bottom: float, top: float, radius: float, **solid: str
    ) -> None:
        super().__init__(path, about, **(solid or GRIPPY))
        self.mass = mass
        outer = Part(ET.SubElement(self.world.element, "body"))
        self.object = outer.body("object")
        for name, pos in (
            ("bottom_site", (0, 0, bottom)),
            ("top_site", (0, 0, top)),
            ("horizontal_radius_site", (radius, 0, 0)),
        ):
            outer.site(name, "sphere", (0.005,), pos)

    def write(self, folder: Path) -> None:
        self.solid.set("density", _text(self.mass / self.object.volume()))
        super().write(folder)


class Part:
    """A body, or a frame in one, that shapes are added to."""

    def __init__(self, element: ET.Element) -> None:
        self.element = element

    def body(self, name: str, pos: Vector = (0, 0, 0), quat: Vector | None = None) -> "Part":
        return Part(self._add("body", name=name, pos=pos if any(pos) else None, quat=quat))

    def lying(self) -> "Part":
        """A frame whose z is the body's y, for what is drawn upright and stored lying on its back."""
        return Part(self._add("frame", xyaxes=(1, 0, 0, 0, 0, -1)))

    def joint(self, name: str, kind: str, axis: Vector, limits: Vector, damping: float) -> None:
        self._add("joint", name=name, type=kind, axis=axis, range=limits, limited="true", damping=damping)

    def inertia(self, mass: float, moment: float) -> None:
        """Mass (kg) and the same moment (kg m²) about every axis, in place of what the solids would have."""
        self._add("inertial", pos=(0, 0, 0), mass=mass, diaginertia=(moment,) * 3)

    def site(
        self,
        name: str,
        kind: str,
        size: Vector,
        pos: Vector,
        quat: Vector = (1, 0, 0, 0),
        rgba: Vector = (0, 0, 0, 0),
    ) -> None:
        """A site with every attribute written out: LIBERO reads them from the XML."""
        self._add("site", name=name, type=kind, pos=pos, quat=quat, size=size, rgba=rgba, group="0")

    def plane(self, name: str, material: str) -> None:
        """A floor that is both felt and seen, as robosuite's arenas have it."""
        self._add("geom", name=name, type="plane", group="1", size=(3, 3, 0.125), pos=(0, 0, 0), material=material)

    def solid(self, name: str, kind: str, size: Vector, pos: Vector, quat: Vector | None = None) -> None:
        self._add("geom", **{"class": "solid"}, name=name, type=kind, size=size, pos=pos, quat=quat)

    def look(
        self,
        kind: str,
        size: Vector,
        pos: Vector,
        rgba: Vector | None,
        quat: Vector | None = None,
        name: str | None = None,
        material: str | None = None,
    ) -> None:
        looks = {"rgba": rgba, "material": material}
        self._add("geom", **{"class": "look"}, name=name, type=kind, size=size, pos=pos, quat=quat, **looks)

    def both(self, name: str, kind: str, size: Vector, pos: Vector, rgba: Vector, quat: Vector | None = None) -> None:
        self.solid(name, kind, size, pos, quat)
        self.look(kind, size, pos, rgba, quat)

    def block(self, name: str, low: Vector, high: Vector, rgba: Vector | None = None) -> None:
        """A box between two corners; without a colour it is not seen."""
        size, pos = _box(low, high)
        self.solid(name, "box", size, pos)
        if rgba is not None:
            self.look("box", size, pos, rgba)

    def paint(self, low: Vector, high: Vector, rgba: Vector) -> None:
        """A box between two corners that is only seen."""
        size, pos = _box(low, high)
        self.look("box", size, pos, rgba)

    def can(self, radius: float, bottom: float, top: float, rgba: Vector, center: Vector = (0, 0)) -> None:
        """An upright cylinder that is only seen."""
        self.look("cylinder", (radius, (top - bottom) / 2), (*center, (bottom + top) / 2), rgba)

    def oval(self, half_x: float, half_y: float, bottom: float, top: float, rgba: Vector) -> None:
        """An upright block with round sides along x, which is only seen."""
        straight = half_x - half_y
        self.paint((-straight, -half_y, bottom), (straight, half_y, top), rgba)
        for x in (-straight, straight):
            self.can(half_y, bottom, top, rgba, (x, 0))

    def drum(self, name: str, sides: int, radius: float, bottom: float, top: float, center: Vector = (0, 0)) -> None:
        """A solid prism of an even number of sides, made of boxes across it, because boxes rest stably on boxes.

        `radius` is that of the circle inside; the corners reach out further.
        """
        size = (radius, radius * math.tan(math.pi / sides), (top - bottom) / 2)
        for k in range(sides // 2):
            quat = turn("z", 2 * math.pi * k / sides) if k else None
            self.solid(f"{name}_{k + 1}", "box", size, (*center, (bottom + top) / 2), quat)

    def ring(
        self,
        name: str | None,
        sides: int,
        low: Vector,
        high: Vector,
        thickness: float,
        rgba: Vector,
        center: Vector = (0, 0),
    ) -> None:
        """A wall around z as boxes, from (radius, height) `low` to `high` of its middle; it may lean outwards.

        Without a name it is only seen.
        """
        (r0, z0), (r1, z1) = low, high
        lean = math.atan2(r1 - r0, z1 - z0)
        width = (max(r0, r1) + thickness / 2) * math.tan(math.pi / sides)
        size = (thickness / 2, width, math.hypot(r1 - r0, z1 - z0) / 2)
        for k in range(sides):
            angle = 2 * math.pi * k / sides
            radius = (r0 + r1) / 2
            pos = (center[0] + radius * math.cos(angle), center[1] + radius * math.sin(angle), (z0 + z1) / 2)
            quat = times(turn("z", angle), turn("y", lean))
            self.look("box", size, pos, rgba, quat)
            if name:
                self.solid(f"{name}_{k + 1}", "box", size, pos, quat)

    def bar(self, name: str, start: Vector, end: Vector, half_y: float, half_z: float, rgba: Vector) -> None:
        """A box along the line between two points of a plane y = constant."""
        (x0, y, z0), (x1, _, z1) = start, end
        size = (math.hypot(x1 - x0, z1 - z0) / 2, half_y, half_z)
        pos = ((x0 + x1) / 2, y, (z0 + z1) / 2)
        self.both(name, "box", size, pos, rgba, turn("y", -math.atan2(z1 - z0, x1 - x0)))

    def volume(self) -> float:
        """Of all solids, counted twice where they overlap, as MuJoCo does; not of bodies whose mass is written out."""
        if self.element.find("inertial") is not None:
            return 0.0
        own = sum(
            _volume(str(geom.get("type")), [float(s) for s in str(geom.get("size")).split()])
            for geom in self.element.findall("geom[@class='solid']")
        )
        inner = [child for child in self.element if child.tag in ("body", "frame")]
        return own + sum(Part(child).volume() for child in inner)

    def _add(self, tag: str, **attributes: str | float | Vector | None) -> ET.Element:
        texts = {key: _text(value) for key, value in attributes.items() if value is not None}
        return ET.SubElement(self.element, tag, texts)


def turn(axis: str, angle: float) -> Vector:
    """The quaternion of a turn about one axis of the frame."""
    return (math.cos(angle / 2), *(math.sin(angle / 2) * (axis == other) for other in "xyz"))


def times(a: Vector, b: Vector) -> Vector:
    """The product of two quaternions: first b, then a."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _box(low: Vector, high: Vector) -> tuple[Vector, Vector]:
    return [(h - o) / 2 for o, h in zip(low, high, strict=True)], [(o + h) / 2 for o, h in zip(low, high, strict=True)]


def _volume(kind: str, size: Vector) -> float:
    match kind:
        case "box":
            return 8 * math.prod(size)
        case "cylinder":
            return math.pi * size[0] ** 2 * 2 * size[1]
        case "capsule":
            return math.pi * size[0] ** 2 * (2 * size[1] + 4 / 3 * size[0])
    raise ValueError(f"no volume of a {kind}")


def _text(value: str | float | Vector) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return " ".join(_text(v) for v in value)
    return f"{round(value, 5) + 0.0:g}"
