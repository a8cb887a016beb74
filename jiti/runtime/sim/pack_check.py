"""Whether an asset pack has what the tasks in simulation need, told before an episode is lost to it.

First the files are read: which are missing, and what is missing in them. When nothing is, every scene is built and
reset once, which is the proof.
"""

import importlib
import json
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from jiti.errors import UsageError
from jiti.progress import Progress
from jiti.runtime.sim.libero import DOWNLOADED, PRIMITIVE, bddl_file, import_libero
from jiti.runtime.sim.pack_needs import FOLDERS, OBJECT, Element, Need, needs_of, parse_problem, scene_of
from jiti.tasks.task import Task


@dataclass(frozen=True, slots=True)
class Lack:
    """Something that tasks need and the pack has not."""

    file: str
    """Its path in the pack, with `/`."""
    what: str
    """The end of a sentence about the file: `is not there`, `has no site 'contain_region': ...`."""
    tasks: tuple[str, ...]
    """Ids of the tasks that cannot be simulated for it."""


def find_pack(assets: str | None) -> Path:
    """The folder that `--assets` means: "primitive" (the default), "libero", which may be downloaded, or a folder."""
    if assets == DOWNLOADED:
        import_libero(DOWNLOADED)
        return Path(importlib.import_module("libero.libero").get_assets_path())
    return PRIMITIVE if assets in (None, "primitive") else Path(assets)


def check_pack(
    folder: Path, catalogue: Iterable[Task], progress: Progress = lambda share, what: None
) -> tuple[Lack, ...]:
    """What a pack lacks for those tasks of a catalogue that have a BDDL file, in the order of the tasks.

    Raises UsageError when the folder is no pack at all, or when hf-libero is not installed.
    """
    folder = folder.expanduser().resolve()
    if not any((folder / name).is_dir() for name in FOLDERS):
        raise UsageError(
            f"{folder} is no asset pack: it has none of the folders {', '.join(FOLDERS)}. Give --assets a folder in "
            f"LIBERO's layout; {PRIMITIVE / 'README.md'} tells how to make one."
        )
    import_libero(PRIMITIVE)
    tasks = [task for task in catalogue if task.bddl is not None]
    problems = {task.task_id: parse_problem(bddl_file(task.bddl or "")) for task in tasks}
    found: dict[tuple[str, str], list[str]] = {}
    for task in tasks:
        for need in needs_of(problems[task.task_id]):
            for file, what in _missing(folder, need):
                ids = found.setdefault((file, what), [])
                ids.extend([task.task_id] if task.task_id not in ids else [])
    if not found:
        scenes = {scene_of(problems[task.task_id]): task for task in reversed(tasks)}
        built = [task for task in tasks if task in scenes.values()]
        for number, task in enumerate(built):
            progress(number / len(built), f"Building {task.task_id}")
            if failure := _build(folder, task):
                scene = scene_of(problems[task.task_id])
                ids = [t.task_id for t in tasks if scene_of(problems[t.task_id]) == scene]
                found[next(needs_of(problems[task.task_id])).file, failure] = ids
    return tuple(Lack(file, what, tuple(ids)) for (file, what), ids in found.items())


def print_check(folder: Path, lacks: tuple[Lack, ...], *, as_json: bool = False) -> None:
    """Say on standard output what is missing, file by file."""
    if as_json:
        print(
            json.dumps({"pack": str(folder), "lacks": [asdict(lack) for lack in lacks]}, indent=2, ensure_ascii=False)
        )
        return
    if not lacks:
        print(f"{folder} has what the tasks need: every scene was built and reset.")
        return
    print(f"{folder} lacks {len(lacks)} thing{'s' if len(lacks) > 1 else ''}:")
    for lack in lacks:
        print(f"{lack.file} {lack.what}\n    needed by {', '.join(lack.tasks)}")


def _missing(folder: Path, need: Need) -> Iterator[tuple[str, str]]:
    """Pairs of a file and what is wrong with it."""
    path = folder / need.file
    if not path.is_file():
        yield need.file, "is not there"
        return
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, OSError, UnicodeDecodeError) as error:
        yield need.file, f"cannot be read: {error}"
        return
    for element in need.elements:
        if what := _missing_element(root, element):
            yield need.file, what
            if element == OBJECT:
                return  # all else is looked for in it
    loose = list(_loose_ends(root))
    for what in loose or (_ungrouped(root) if need.is_thing else ()):
        yield need.file, what
    replaced = dict(need.textures)
    for asset in _assets(root):
        if asset.get("file") is None:
            continue
        target = Path(str(asset.get("file")))
        if asset.tag == "texture" and asset.get("name") in replaced:
            target = target.parent / replaced[str(asset.get("name"))]
        if not (path.parent / target).is_file():
            name = asset.get("name") or target.stem
            yield _within(folder, path.parent / target), f"is not there: {need.file} has a {asset.tag} '{name}' from it"


def _missing_element(root: ET.Element, element: Element) -> str | None:
    found = root.findall(element.path)
    if not found:
        return f"has no {element.named}: {element.why}"
    for attribute in element.attributes:
        if all(one.get(attribute) is None for one in found):
            return f"has no attribute '{attribute}' on the {element.named}: {element.why}"
    return None


def _loose_ends(root: ET.Element) -> Iterator[str]:
    """Names that the file speaks of and does not have. robosuite knows of no default but a class's own."""
    classes = {one.get("class") for one in root.findall("default/default")}
    for used in sorted({str(one.get("class")) for one in root.iter() if one.get("class")} - classes):
        yield f"has no class '{used}' right under its first <default>, where robosuite looks for it"
    for tag, attribute, owners in (
        ("mesh", "mesh", root.iterfind("worldbody//geom")),
        ("material", "material", root.iterfind("worldbody//geom")),
        ("texture", "texture", root.iterfind("asset/material")),
    ):
        known = {one.get("name") or Path(one.get("file", "")).stem for one in _assets(root) if one.tag == tag}
        used = {str(owner.get(attribute)) for owner in owners if owner.get(attribute)}
        for name in sorted(used - known):
            yield f"has no {tag} '{name}', which it uses"


def _assets(root: ET.Element) -> list[ET.Element]:
    """What robosuite takes: of the first <asset> only, and only the first of a name."""
    first = root.find("asset")
    named: dict[tuple[str, str], ET.Element] = {}
    for asset in first if first is not None else ():
        named.setdefault((asset.tag, asset.get("name") or asset.get("file", "")), asset)
    return list(named.values())


def _ungrouped(root: ET.Element) -> Iterator[str]:
    """robosuite takes geoms of group 0 for what is felt and of group 1 for what is seen, and needs one or the other."""
    by_class = {one.get("class"): one.find("geom") for one in root.findall("default/default")}

    def group(geom: ET.Element) -> str | None:
        default = by_class.get(geom.get("class"))
        return geom.get("group") or (default.get("group") if default is not None else None)

    groups = {group(geom) for geom in root.iterfind("worldbody/body/body[@name='object']//geom")}
    if None in groups:
        yield "has a geom without a group in the body 'object': 0 is what is felt and 1 what is seen"
    elif "0" not in groups:
        yield "has no geom of group 0 in the body 'object': nothing could touch it"


def _within(folder: Path, path: Path) -> str:
    """A path in the pack, or the whole of one outside it."""
    path = path.resolve()
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else str(path)


def _build(folder: Path, task: Task) -> str | None:
    """What went wrong when a scene was built and reset, from its BDDL file and from LIBERO's initial states."""
    from jiti.runtime.sim.scene import Scene

    try:
        with Scene(task, assets=folder) as scene:
            scene.reset(0, "sampled")
            scene.reset(0, "file")
    except Exception as error:  # MuJoCo and LIBERO raise anything on a pack that they cannot build
        return f"does not build with the things of {task.task_id}: {type(error).__name__}: {error}"
    return None
