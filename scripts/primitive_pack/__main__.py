"""Write the asset pack `primitive`. Usage: python scripts/primitive_pack [FOLDER]"""

import sys
from pathlib import Path

from dishes import dishes
from food import groceries
from furniture import furniture
from rooms import rooms
from textures import write_textures

PACK = Path(__file__).parents[2] / "jiti/runtime/sim/packs/primitive"


def write_pack(folder: Path) -> None:
    for model in (*groceries(), *dishes(), *furniture(), *rooms()):
        model.write(folder)
    write_textures(folder / "textures")


if __name__ == "__main__":
    write_pack(Path(sys.argv[1]) if len(sys.argv) > 1 else PACK)
