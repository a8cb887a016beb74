"""`jiti tasks check`: every thing that a pack can lack is named with its file and the tasks that need it."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from jiti.errors import UsageError
from jiti.runtime.sim.libero import PRIMITIVE
from jiti.runtime.sim.pack_check import Lack, check_pack, print_check
from jiti.tasks.catalogue import load_catalogue
from jiti.tasks.task import Task

pytestmark = pytest.mark.sim

BASKET = "stable_scanned_objects/basket/basket.xml"
CABINET = "articulated_objects/wooden_cabinet.xml"
KITCHEN = "scenes/libero_kitchen_tabletop_base_style.xml"
STOVE = "articulated_objects/flat_stove.xml"

Edit = Callable[[Path], object]


@pytest.fixture
def pack(tmp_path: Path) -> Path:
    """A copy of the primitive pack, to spoil."""
    return shutil.copytree(PRIMITIVE, tmp_path / "pack")


def tasks(*ids: str) -> list[Task]:
    catalogue = load_catalogue()
    return [catalogue.task(i) for i in ids]


def replaced(file: str, old: str, new: str) -> Edit:
    def edit(pack: Path) -> None:
        text = (pack / file).read_text()
        assert old in text
        (pack / file).write_text(text.replace(old, new))

    return edit


def removed(file: str) -> Edit:
    return lambda pack: (pack / file).unlink()


@pytest.mark.parametrize(
    ("edit", "task", "file", "said"),
    [
        (removed(BASKET), "elegant/T0", BASKET, "is not there"),
        (removed(KITCHEN), "elegant/T3", KITCHEN, "is not there"),
        (removed("textures/gray_ceramic_tile.png"), "elegant/T3", "textures/gray_ceramic_tile.png", "'texplane'"),
        (replaced(BASKET, "<body>", "<body"), "elegant/T0", BASKET, "cannot be read"),
        (replaced(BASKET, '"object"', '"basket"'), "elegant/T0", BASKET, "has no body 'object'"),
        (replaced(BASKET, "top_site", "upper_site"), "elegant/T0", BASKET, "has no site 'top_site'"),
        (replaced(BASKET, "contain_region", "inside"), "elegant/T0", BASKET, "basket_1_contain_region"),
        (replaced(BASKET, 'quat="0 0 0 1"', ""), "elegant/T0", BASKET, "has no attribute 'quat'"),
        (replaced(BASKET, 'group="0" friction', "friction"), "elegant/T0", BASKET, "has a geom without a group"),
        (replaced(BASKET, 'geom group="0"', 'geom group="1"'), "elegant/T0", BASKET, "has no geom of group 0"),
        (replaced(BASKET, 'class="solid" name', 'class="soft" name'), "elegant/T0", BASKET, "has no class 'soft'"),
        (replaced(BASKET, 'name="floor" type="box"', 'name="floor" mesh="m"'), "elegant/T0", BASKET, "has no mesh 'm'"),
        (replaced(STOVE, '"burner" type="cylinder"', '"glow" type="cylinder"'), "elegant/T3", STOVE, "site 'burner'"),
        (replaced(STOVE, "<joint", "<unjoint"), "elegant/T3", STOVE, "has no joint"),
        (replaced(CABINET, '<joint name="top', '<unjoint name="top'), "g4/close-top-drawer", CABINET, "'top_region'"),
        (replaced(KITCHEN, "table_leg3_visual", "leg"), "elegant/T3", KITCHEN, "has no geom 'table_leg3_visual'"),
        (replaced(KITCHEN, '"floorplane" texture', '"tiles" texture'), "elegant/T3", KITCHEN, "material 'floorplane'"),
    ],
)
def test_what_is_missing_is_named(pack: Path, edit: Edit, task: str, file: str, said: str) -> None:
    edit(pack)
    lacks = check_pack(pack, tasks(task))
    assert [lack.file for lack in lacks] == [file]
    assert said in lacks[0].what
    assert lacks[0].tasks == (task,)


def test_a_lack_names_every_task_that_needs_it_and_no_other(pack: Path) -> None:
    removed("stable_hope_objects/milk/milk.xml")(pack)
    (lack,) = check_pack(pack, load_catalogue())
    assert lack.file == "stable_hope_objects/milk/milk.xml"
    assert {"elegant/T0", "rq3/seen-A", "g4/ketchup"} <= set(lack.tasks)
    assert not {"elegant/T1", "rq3/unseen-D"} & set(lack.tasks)
    assert len(lack.tasks) == len(set(lack.tasks))


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (replaced(STOVE, 'range="-0.005 2.1"', 'range="2.1 -0.005"'), "range"),
        (replaced(STOVE, "</body>\n        </body>", '<joint name="lid" type="slide"/></body></body>'), "joints"),
    ],
)
def test_what_only_a_build_shows_is_found_by_building(pack: Path, edit: Edit, said: str) -> None:
    edit(pack)
    (lack,) = check_pack(pack, tasks("elegant/T3"))
    assert lack.file == KITCHEN
    assert "does not build with the things of elegant/T3" in lack.what
    assert said in lack.what


def test_libero_s_own_pack_has_what_it_needs(shared: Path) -> None:
    assert check_pack(shared / "libero-assets", tasks("elegant/T3")) == ()


@pytest.mark.slow
def test_the_primitive_pack_has_what_every_task_needs() -> None:
    said: list[str] = []
    assert check_pack(PRIMITIVE, load_catalogue(), lambda share, what: said.append(what)) == ()
    assert "Building elegant/T0" in said
    assert "Building g4/ketchup" not in said, "the same scene is built once"


@pytest.mark.parametrize("name", ["", "nowhere"])
def test_a_folder_that_is_no_pack_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="is no asset pack: it has none of the folders scenes"):
        check_pack(tmp_path / name, [])


def test_what_is_printed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    lack = Lack("a.xml", "is not there", ("elegant/T0", "elegant/T1"))
    print_check(tmp_path, (lack,))
    assert (
        capsys.readouterr().out
        == f"{tmp_path} lacks 1 thing:\na.xml is not there\n    needed by elegant/T0, elegant/T1\n"
    )
    print_check(tmp_path, (lack,), as_json=True)
    found = json.loads(capsys.readouterr().out)
    assert found == {
        "pack": str(tmp_path),
        "lacks": [{"file": "a.xml", "what": "is not there", "tasks": ["elegant/T0", "elegant/T1"]}],
    }


def test_the_command_asks_nothing_and_leaves_nothing_at_home(pack: Path, tmp_path: Path) -> None:
    removed("turbosquid_objects/black_book/black_book.xml")(pack)
    home = tmp_path / "home"
    home.mkdir()
    environment = {k: v for k, v in os.environ.items() if k != "LIBERO_CONFIG_PATH"} | {"HOME": str(home)}
    command = [sys.executable, "-m", "jiti", "tasks", "check", "--assets", str(pack), "--json"]
    done = subprocess.run(
        command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 1
    assert done.stderr == ""
    (lack,) = json.loads(done.stdout)["lacks"]
    assert lack["tasks"] == ["elegant/T4", "elegant/T5", "elegant/T7"]
    assert not (home / ".libero").exists()
