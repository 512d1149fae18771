"""Every module with kernels compiles for CUDA, without a GPU: the same source has to serve both targets."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest
import warp as wp

ROOT = Path(__file__).parents[2]
ARCHITECTURES = (80, 90)  # the oldest that is supported, and a recent one


def modules_with_kernels() -> list[str]:
    """Names of all modules of both packages that define at least one Warp kernel."""
    files = [path for package in ("wkernels", "algorithms") for path in sorted((ROOT / package).rglob("*.py"))]
    with_kernels = [path for path in files if "\n@wp.kernel" in path.read_text(encoding="utf-8")]
    return [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in with_kernels]


@pytest.mark.parametrize("name", modules_with_kernels())
def test_module_compiles_for_cuda(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To PTX of every architecture."""
    monkeypatch.setattr(wp.config, "optimization_level", 2)  # whatever compiles at 3, in two thirds of the time
    module = importlib.import_module(name)
    for arch in ARCHITECTURES:
        folder = tmp_path / str(arch)
        wp.compile_aot_module(module, arch=arch, module_dir=folder, use_ptx=True)
        compiled = list(folder.glob("*.ptx"))
        assert compiled, f"{name} left no PTX"
        text = compiled[0].read_text(encoding="utf-8", errors="replace")
        assert ".visible .entry" in text and f".target sm_{arch}" in text
