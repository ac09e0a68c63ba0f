"""Write locked.txt: what taut itself needs, with versions and hashes: `pip install --require-hashes -r locked.txt`.

The hashes are those of the files for this machine and this version of Python. Audit: `pip-audit -r locked.txt`.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main() -> None:
    """Ask pip what it would install, and write that down."""
    words = subprocess.check_output([sys.executable, str(ROOT / "tools" / "core_requirements.py")], text=True).split()
    with tempfile.NamedTemporaryFile() as report:
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
        pins = ["-c", str(ROOT / "constraints.txt"), "--only-binary", ":all:", "--report", report.name]
        subprocess.run([*command, *pins, *words], check=True)
        found = json.loads(Path(report.name).read_text(encoding="utf-8"))["install"]
    lines = sorted(
        f"{one['metadata']['name']}=={one['metadata']['version']} "
        f"--hash=sha256:{one['download_info']['archive_info']['hashes']['sha256']}"
        for one in found
    )
    head = f"# Of Python {sys.version_info.major}.{sys.version_info.minor} on {sys.platform}; made by tools/lock.py"
    (ROOT / "locked.txt").write_text("\n".join([head, *lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
