"""What can be asked of a simulated scene by name: poses, extents, contacts, what lies under what.

Names are those of the task's BDDL file: objects (`ketchup_1`), fixtures (`flat_stove_1`) and regions
(`basket_1_contain_region`). Everything is in the world's frame, in metres and radians; z points up.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from jiti.errors import UsageError

GRIPPER, LEFT, RIGHT, ROBOT = "gripper", "left finger", "right finger", "robot"
"""Names for parts of the robot in `touching`. The gripper is the hand with its fingers."""
_SIGNS = np.array(list(product((-1.0, 1.0), repeat=3)))
_DOWN = np.array([0.0, 0.0, -1.0])
_PROJECTIONS, _SAME_M = 100, 1e-6
"""When projecting between two boxes ends. Our choice: faces take two, edges some ten."""


@dataclass(frozen=True, slots=True)
class Names:
    """What a task's scene is made of, as its BDDL file has it."""

    objects: tuple[str, ...]
    """That can be carried away: each has a free joint."""
    fixtures: tuple[str, ...]
    """That stand firmly; their parts may move."""
    regions: Mapping[str, str | None]
    """Boxes that predicates speak of, with the object or fixture that they belong to; None for those of the table."""


class World:
    """A view of MuJoCo's model and data; it holds no state, and shows what the simulation is at when it is asked."""

    def __init__(self, model: Any, data: Any, names: Names) -> None:
        import mujoco

        self._mujoco: Any = mujoco
        self.model, self.data, self.names = model, data, names
        owners = (*names.objects, *names.fixtures)
        self._body = {name: model.body(f"{name}_main").id for name in owners}
        parts = {name: self._subtree(body) for name, body in self._body.items()}
        robot = [
            model.body(k).id for k in range(model.nbody) if model.body(k).name.startswith(("robot0_", "gripper0_"))
        ]
        hand = [k for k in robot if model.body(k).name.startswith("gripper0_")]
        self._geoms = {name: self._solid(bodies) for name, bodies in parts.items()}
        self._geoms |= {ROBOT: self._solid(robot), GRIPPER: self._solid(hand)}
        self._geoms[LEFT] = self._named(GRIPPER, "finger1")
        self._geoms[RIGHT] = self._named(GRIPPER, "finger2")
        self._sorted = {name: np.array(sorted(geoms), dtype=np.int64) for name, geoms in self._geoms.items()}
        self._parts: dict[int, list[str]] = {}
        for name, geoms in self._geoms.items():
            for geom in geoms:
                self._parts.setdefault(geom, []).append(name)
        self._points = {name: self._corners(geoms) for name, geoms in self._geoms.items()}
        self._round = {name: [g for g in geoms if self._is_round(g)] for name, geoms in self._geoms.items()}
        self._joints = {
            name: tuple(j for j in range(model.njnt) if model.jnt_bodyid[j] in parts[name] and model.jnt_type[j] != 0)
            for name in owners
        }

    def position(self, name: str) -> np.ndarray:
        """(3,) m: the origin of an object's or fixture's body, or the middle of a region."""
        if name in self._body:
            return self.data.xpos[self._body[name]].copy()
        return self.data.site_xpos[self._site(name)].copy()

    def rotation(self, name: str) -> np.ndarray:
        """(3, 3): axes of an object, a fixture or a region, in the world."""
        source, index = (
            (self.data.xmat, self._body[name]) if name in self._body else (self.data.site_xmat, self._site(name))
        )
        return source[index].reshape(3, 3).copy()

    def pose(self, name: str) -> np.ndarray:
        """(4, 4): world_T_name."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotation(name), self.position(name)
        return pose

    def half_size(self, region: str) -> np.ndarray:
        """(3,) m: half extents of a region along its own axes."""
        return np.array(self.model.site_size[self._site(region)])

    def solid(self, name: str) -> frozenset[int]:
        """Geoms that collide, of an object, a fixture, the owner of a region, or a part of the robot."""
        return self._geoms[self.owner(name)]

    def owner(self, name: str) -> str:
        """The object or fixture that a region belongs to; any other name is its own. Raises UsageError."""
        if name in self._geoms:
            return name
        owner = self.names.regions.get(name)
        if owner is None:
            known = ", ".join((*self.names.objects, *self.names.fixtures))
            raise UsageError(f"{name!r} is not a thing of this scene, which has: {known}")
        return owner

    def extent(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """(3,) and (3,) m: least and greatest corner of what collides of a thing, along the axes of its own body."""
        pose = self.pose(self.owner(name))
        local = (self._corners_now(name) - pose[:3, 3]) @ pose[:3, :3]
        return local.min(axis=0), local.max(axis=0)

    def bounds(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """(3,) and (3,) m: the same along the world's axes."""
        points = self._corners_now(name)
        return points.min(axis=0), points.max(axis=0)

    def lowest_m(self, name: str) -> float:
        """Height of the lowest point of what collides of a thing."""
        owner = self.owner(name)
        edges = self._corners_now(owner, without=self._round[owner])
        return min([*(self._lowest(g) for g in self._round[owner]), *edges[:, 2].tolist()])

    def floor_m(self, name: str, under: np.ndarray) -> float | None:
        """Height at which a line that falls from `under` (3,) first meets a thing; None where it passes by."""
        below = [d for g in self.solid(name) if (d := self._ray(g, under)) is not None]
        return float(under[2] - min(below)) if below else None

    def touching(self, one: str, other: str) -> bool:
        """Whether two things touch at this moment."""
        return (self.owner(one), self.owner(other)) in self.contacts((one, other))

    def contacts(self, among: Iterable[str] | None = None) -> frozenset[tuple[str, str]]:
        """Pairs of names that touch, both ways round; among objects, fixtures and gripper unless others are named."""
        names = {self.owner(n) for n in among} if among else {*self.names.objects, *self.names.fixtures, GRIPPER}
        found = set()
        for first, second in set(zip(*self.data.contact.geom.T.tolist(), strict=True)):
            for one in self._parts.get(first, ()):
                for other in self._parts.get(second, ()):
                    if one != other and one in names and other in names:
                        found |= {(one, other), (other, one)}
        return frozenset(found)

    def gap_m(self, one: str, other: str, *, most_m: float = 0.2) -> float:
        """Least distance between two things that collide, 0 where they touch; `most_m` when they are further apart."""
        a, b = self._sorted[self.owner(one)], self._sorted[self.owner(other)]
        between = np.linalg.norm(self.data.geom_xpos[a][:, None] - self.data.geom_xpos[b][None], axis=-1)
        # Lower bounds, from the spheres around the shapes: the nearest first, until none can be nearer.
        bounds = (between - self.model.geom_rbound[a][:, None] - self.model.geom_rbound[b][None]).ravel()
        least = most_m
        for index in np.argsort(bounds, kind="stable"):
            if bounds[index] >= least:
                break
            least = min(least, self._distance_m(int(a[index // len(b)]), int(b[index % len(b)]), least))
        return float(least)

    def _distance_m(self, first: int, second: int, most_m: float) -> float:
        """Between two shapes, 0 where they touch.

        MuJoCo 3.8.1's `mj_geomDistance` gives exactly 0 for one in twenty pairs of boxes that are well apart. A 0
        without a contact is therefore replaced by the distance of the boxes around the two shapes.
        """
        found = self._mujoco.mj_geomDistance(self.model, self.data, first, second, most_m, None)
        if found > 0:
            return float(found)
        touching = (np.sort(self.data.contact.geom, axis=1) == sorted((first, second))).all(axis=1).any()
        return 0.0 if touching else min(most_m, self._boxes_apart_m(first, second))

    def _boxes_apart_m(self, first: int, second: int) -> float:
        """Between the boxes around two shapes, by projecting a point from one to the other in turn (von Neumann)."""
        place = self.data.geom_xpos[second]
        apart_m = np.inf
        for _ in range(_PROJECTIONS):
            on_first = self._nearest_in_box(first, place)
            place = self._nearest_in_box(second, on_first)
            last_m, apart_m = apart_m, float(np.linalg.norm(place - on_first))
            if last_m - apart_m < _SAME_M:
                break
        return apart_m

    def _nearest_in_box(self, geom: int, place: np.ndarray) -> np.ndarray:
        """(3,): the point of the box around a shape that is nearest to a place (3,)."""
        at, turn = self.data.geom_xpos[geom], self.data.geom_xmat[geom].reshape(3, 3)
        middle, half = self.model.geom_aabb[geom][:3], self.model.geom_aabb[geom][3:]
        return at + turn @ np.clip((place - at) @ turn, middle - half, middle + half)

    def joints(self, name: str) -> np.ndarray:
        """(n,) m or rad: how far the moving parts of a fixture stand, in the order of its file."""
        return np.array([self.data.qpos[self.model.jnt_qposadr[j]] for j in self._joints_of(name)])

    def joint_speeds(self, name: str) -> np.ndarray:
        """(n,) m/s or rad/s: how fast they move."""
        return np.array([self.data.qvel[self.model.jnt_dofadr[j]] for j in self._joints_of(name)])

    def moves_along(self, part: str, place: np.ndarray) -> np.ndarray:
        """(3,) unit vector: where a place (3,) on a fixture's moving part goes when its joint's number grows.

        `part` is a region on the part, or a fixture that has one moving part.
        """
        joint = self._joint_of(part)
        axis = np.array(self.data.xaxis[joint])
        if not self.hinged(part):
            return axis
        way = np.cross(axis, place - self.data.xanchor[joint])
        return way / np.linalg.norm(way)

    def handle(self, part: str) -> np.ndarray:
        """(3,) in the frame of a fixture's moving part: the middle of the face that is last on its way, a handle's."""
        body, placed, whose = self._moving(part)
        way = self.moves_along(part, placed.mean(axis=0))
        last = min(set(whose.tolist()), key=lambda g: float((placed[whose == g] @ way).min()))
        middle = placed[whose == last].mean(axis=0)
        middle += way * ((placed[whose == last] @ way).min() - middle @ way)
        return self.data.xmat[body].reshape(3, 3).T @ (middle - self.data.xpos[body])

    def top_m(self, part: str) -> float:
        """Height of the highest point of a fixture's moving part."""
        return float(self._moving(part)[1][:, 2].max())

    def hinge(self, part: str) -> np.ndarray:
        """(3,) m: a point of the axis about which a door turns."""
        return np.array(self.data.xanchor[self._joint_of(part)])

    def turned_back(self, part: str, way: np.ndarray) -> np.ndarray:
        """(3,): a direction of the world in the frame of a fixture's moving part."""
        return self.data.xmat[self._moving(part)[0]].reshape(3, 3).T @ way

    def hinged(self, part: str) -> bool:
        """Whether a fixture's moving part turns, as a door, or slides, as a drawer."""
        return bool(self.model.jnt_type[self._joint_of(part)] == self._mujoco.mjtJoint.mjJNT_HINGE)

    def _moving(self, part: str) -> tuple[int, np.ndarray, np.ndarray]:
        """Body of a fixture's moving part, corners (n, 3) of what collides of it, and whose they are (n,)."""
        body = int(self.model.jnt_bodyid[self._joint_of(part)])
        points, whose = self._corners(g for g in self.solid(part) if self.model.geom_bodyid[g] == body)
        return body, self._placed(points, whose), whose

    def carried(self, part: str, local: np.ndarray) -> np.ndarray:
        """(3,) m: where a place (3,) in the frame of a fixture's moving part is now."""
        body = int(self.model.jnt_bodyid[self._joint_of(part)])
        return self.data.xpos[body] + self.data.xmat[body].reshape(3, 3) @ local

    def _joint_of(self, part: str) -> int:
        joints = self._joints_of(part)
        if len(joints) != 1:
            raise UsageError(f"{part!r} has {len(joints)} moving parts; name a region on the one that is meant")
        return joints[0]

    def fastest_m_s(self) -> float:
        """Speed of the fastest object, by its centre of mass."""
        bodies = [self._body[name] for name in self.names.objects]
        return float(np.linalg.norm(self.data.cvel[bodies, 3:], axis=1).max(initial=0.0))

    def _joints_of(self, name: str) -> tuple[int, ...]:
        if name in self._body:
            return self._joints[name]
        # A region of a fixture moves with the body that it is fixed to.
        body = int(self.model.site_bodyid[self._site(name)])
        return tuple(j for j in self._joints[self.owner(name)] if self.model.jnt_bodyid[j] == body)

    def _site(self, name: str) -> int:
        if name not in self.names.regions:
            known = ", ".join((*self._body, *self.names.regions))
            raise UsageError(f"this scene has no {name!r}; it has: {known}")
        return self.model.site(name).id

    def _subtree(self, root: int) -> frozenset[int]:
        found = {root}
        for body in range(root + 1, self.model.nbody):
            if self.model.body_parentid[body] in found:
                found.add(body)
        return frozenset(found)

    def _solid(self, bodies: Iterable[int]) -> frozenset[int]:
        inside = np.isin(self.model.geom_bodyid, list(bodies))
        return frozenset(np.flatnonzero(inside & (self.model.geom_contype | self.model.geom_conaffinity > 0)).tolist())

    def _named(self, name: str, part: str) -> frozenset[int]:
        return frozenset(g for g in self._geoms[name] if part in self.model.geom(g).name)

    def _is_mesh(self, geom: int) -> bool:
        return self.model.geom_type[geom] == self._mujoco.mjtGeom.mjGEOM_MESH

    def _is_round(self, geom: int) -> bool:
        """Whether a shape bulges beyond no corner: its lowest point is not one of its box's."""
        shapes = self._mujoco.mjtGeom
        bulges = (shapes.mjGEOM_SPHERE, shapes.mjGEOM_CAPSULE, shapes.mjGEOM_CYLINDER, shapes.mjGEOM_ELLIPSOID)
        return self.model.geom_type[geom] in bulges

    def _corners(self, geoms: Iterable[int]) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) m in the frames of their geoms, and (n,) whose they are: a mesh's vertices, else its box's corners."""
        points: list[np.ndarray] = [np.empty((0, 3))]
        whose: list[np.ndarray] = [np.empty(0, np.int64)]
        for geom in sorted(geoms):
            if self._is_mesh(geom):
                mesh = self.model.geom_dataid[geom]
                start, count = self.model.mesh_vertadr[mesh], self.model.mesh_vertnum[mesh]
                own = np.array(self.model.mesh_vert[start : start + count], dtype=np.float64)
            else:
                own = self.model.geom_aabb[geom][:3] + _SIGNS * self.model.geom_aabb[geom][3:]
            points.append(own)
            whose.append(np.full(len(own), geom))
        return np.concatenate(points), np.concatenate(whose)

    def _corners_now(self, name: str, without: Iterable[int] = ()) -> np.ndarray:
        """(n, 3) m: the corners of what collides of a thing, in the world."""
        points, whose = self._points[self.owner(name)]
        if without:
            kept = ~np.isin(whose, list(without))
            points, whose = points[kept], whose[kept]
        return self._placed(points, whose)

    def _placed(self, points: np.ndarray, whose: np.ndarray) -> np.ndarray:
        turns = self.data.geom_xmat[whose].reshape(-1, 3, 3)
        return self.data.geom_xpos[whose] + np.einsum("nij,nj->ni", turns, points)

    def _lowest(self, geom: int) -> float:
        """Height of the lowest point of a round shape."""
        kind, size = self.model.geom_type[geom], self.model.geom_size[geom]
        middle = float(self.data.geom_xpos[geom][2])
        up = np.abs(self.data.geom_xmat[geom].reshape(3, 3)[2])  # how far each of its axes points up
        shapes = self._mujoco.mjtGeom
        if kind == shapes.mjGEOM_SPHERE:
            return middle - float(size[0])
        if kind == shapes.mjGEOM_CAPSULE:
            return middle - float(size[0] + size[1] * up[2])
        if kind == shapes.mjGEOM_CYLINDER:
            return middle - float(size[0] * np.sqrt(max(0.0, 1 - up[2] ** 2)) + size[1] * up[2])
        return middle - float(np.linalg.norm(size * up))

    def _ray(self, geom: int, start: np.ndarray) -> float | None:
        """How far below a point (3,) a geom is met by a vertical line."""
        away = self.data.geom_xpos[geom] - start
        if away[0] ** 2 + away[1] ** 2 > self.model.geom_rbound[geom] ** 2:
            return None
        if self._is_mesh(geom):
            distance = self._mujoco.mj_rayMesh(self.model, self.data, geom, start, _DOWN)
        else:
            at, turn = self.data.geom_xpos[geom], self.data.geom_xmat[geom]
            size, kind = self.model.geom_size[geom], int(self.model.geom_type[geom])
            distance = self._mujoco.mju_rayGeom(at, turn, size, start, _DOWN, kind)
        return float(distance) if distance >= 0 else None
