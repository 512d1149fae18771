"""The repository as text: its files, and which modules a Python file imports."""

from __future__ import annotations

import ast
import subprocess
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LAYERS = ("wkernels", "algorithms", "experiments")
"""The packages from the ground up; each imports only itself and those before it."""


def sources(layer: str) -> list[Path]:
    """All Python files of a package."""
    return sorted((ROOT / layer).rglob("*.py"))


def imports_of(text: str, package: str) -> Iterator[str]:
    """Full names of the modules that a file imports anywhere in it; ``package`` is what relative imports start from."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def package_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).parent.parts)


def project_files() -> list[Path]:
    """Files that git tracks or would track; everything but caches where there is no git."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    if listed.returncode == 0 and listed.stdout:
        found = [ROOT / name for name in listed.stdout.decode().split("\0") if name]
    else:
        found = [path for path in ROOT.rglob("*") if not any(part.startswith((".", "__")) for part in path.parts)]
    return [path for path in found if path.is_file()]
