"""Write `constraints.txt`: the versions that the tests ran with, for those who install with pip.

    uv run scripts/constraints.py           # after a change of dependencies in pyproject.toml
    uv run scripts/constraints.py --check   # ends with 1 when the file is not what would be written

    pip install -c constraints.txt 'jiti[sim]'

uv's lock file names the hosts that it was made with, so it stays out of the repository; this file names none.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "constraints.txt"
HEADER = "# Versions that the tests ran with; made by scripts/constraints.py. pip install -c constraints.txt jiti\n"
EXPORT = [
    *("uv", "export", "--quiet", "--all-extras", "--all-groups", "--no-emit-project"),
    *("--no-hashes", "--no-header", "--no-annotate"),
]
PIN = re.compile(r"(?P<name>[A-Za-z0-9][A-Za-z0-9._-]*)==(?P<version>[A-Za-z0-9.!+_-]+)(?P<marker> ; [^#@]+)?")
"""A name, one version, and where it holds: no address, no file, no option."""


def constraints() -> str:
    """The text of the file. Raises SystemExit with uv's message, or when uv gives a line that is not a pin."""
    exported = subprocess.run(EXPORT, cwd=ROOT, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if exported.returncode != 0:
        sys.exit(f"{' '.join(EXPORT)} failed:\n{exported.stderr}")
    lines = exported.stdout.splitlines()
    if strange := [line for line in lines if not PIN.fullmatch(line)]:
        sys.exit(f"uv gives {strange[0]!r}, which is not a name with a version; pip could not be told without a host")
    return HEADER + "\n".join(sorted(lines, key=str.lower)) + "\n"


def main(arguments: list[str]) -> int:
    if arguments not in ([], ["--check"]):
        print(__doc__)
        return 2
    text = constraints()
    if arguments:
        same = FILE.is_file() and FILE.read_text() == text
        print("constraints.txt is up to date" if same else "constraints.txt is old; run: uv run scripts/constraints.py")
        return 0 if same else 1
    temporary = FILE.with_suffix(".new")
    temporary.write_text(text)
    temporary.replace(FILE)
    print(f"{len(text.splitlines()) - 1} versions in {FILE.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
