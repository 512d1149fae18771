"""The worked example of docs/lanes.md runs as it stands there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_the_worked_example_runs(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "lanes.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    assert len(blocks) == 2
    file = tmp_path / "example.py"  # Warp reads a kernel's source from its file
    file.write_text("\n".join(blocks) + "\nprint('ran to its end')\n", encoding="utf-8")
    done = subprocess.run([sys.executable, file], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "ran to its end"


def test_every_name_of_the_vocabulary_is_explained() -> None:
    import wkernels.device.lanes as lanes

    page = (ROOT / "docs" / "lanes.md").read_text(encoding="utf-8")
    names = {name for name in vars(lanes) if not name.startswith("_")} - {"annotations", "wp"}
    assert len(names) >= 8
    assert not {name for name in names if name not in page}
