"""Rules that a reader of one file cannot see: which way imports point, file sizes, the shape of kernels."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from source_tree import LAYERS, ROOT, imports_of, package_of, project_files, sources

from algorithms.plugins import load_all

MAX_LINES = 400
# written in pieces, so that this file does not contain what it looks for
REGISTRIES = (
    "py" + "pi.org",
    "pythonhosted" + ".org",
    "ana" + "conda.org",
    "conda" + ".io",
    "npm" + "js.org",
    "crates" + ".io",
    "proxy.golang" + ".org",
)


ALL = [path for layer in LAYERS for path in sources(layer)]


def forbidden(layer: str, imported: str) -> bool:
    head = imported.split(".")[0]
    return head in LAYERS and LAYERS.index(head) > LAYERS.index(layer)


def is_technique(path: Path) -> bool:
    parts = path.relative_to(ROOT).parts
    return len(parts) == 3 and parts[0] == "algorithms" and parts[1] != "projections" and path.stem[0] != "_"


def other_technique(path: Path, imported: str) -> bool:
    """Whether a module name is another plugin's file; what two plugins share lives below them."""
    target = ROOT.joinpath(*imported.split(".")).with_suffix(".py")
    return target != path and target.is_file() and is_technique(target)


def test_there_is_something_to_walk() -> None:
    assert all(sources(layer) for layer in LAYERS)
    assert {path.stem for path in ALL if is_technique(path)} == set(load_all())


@pytest.mark.parametrize("layer", LAYERS)
def test_imports_point_one_way(layer: str) -> None:
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in sources(layer)
        for name in imports_of(path.read_text(encoding="utf-8"), package_of(path))
        if forbidden(layer, name)
    ]
    assert not wrong, wrong


def test_no_technique_imports_another() -> None:
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in sources("algorithms")
        if is_technique(path)
        for name in imports_of(path.read_text(encoding="utf-8"), package_of(path))
        if other_technique(path, name)
    ]
    assert not wrong, wrong


def test_the_walk_sees_every_form_of_import() -> None:
    text = "import a.b as c\nfrom d import e\ndef f():\n    from ..g import h\n    from . import i\n"
    names = set(imports_of(text, "algorithms.hard"))
    assert {"a.b", "d", "d.e", "algorithms.g.h", "algorithms.hard.i"} <= names
    assert forbidden("wkernels", "algorithms.technique") and forbidden("algorithms", "experiments")
    assert not forbidden("experiments", "wkernels.frame.session") and not forbidden("wkernels", "numpy")
    pcf, pcss = ROOT / "algorithms/filtering/pcf.py", "algorithms.filtering.pcss"
    assert other_technique(pcf, pcss) and not other_technique(pcf, "algorithms.filtering.pcf")
    assert not other_technique(pcf, "algorithms.technique") and not other_technique(pcf, "wkernels.filters.penumbra")


def test_files_stay_short() -> None:
    lines = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in ALL}
    long = {name: count for name, count in lines.items() if count > MAX_LINES}
    assert not long, f"over {MAX_LINES} lines: {long}"


def kernels_of(tree: ast.Module) -> Iterator[tuple[ast.FunctionDef, bool]]:
    """Every function decorated with ``wp.kernel``, and whether it is at module scope."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef):
            continue
        for decorator in node.decorator_list:
            called = decorator.func if isinstance(decorator, ast.Call) else decorator
            if ast.unparse(called) in ("wp.kernel", "warp.kernel", "kernel"):
                yield node, node in tree.body


def kernel_faults(text: str) -> list[str]:
    faults = []
    for kernel, at_module_scope in kernels_of(ast.parse(text)):
        arguments = kernel.args.args
        if not at_module_scope:
            faults.append(f"line {kernel.lineno}: kernel {kernel.name} is not at module scope")
        if (
            not arguments
            or arguments[0].arg != "first"
            or ast.unparse(arguments[0].annotation or ast.Constant("")) != "int"
        ):
            faults.append(f"line {kernel.lineno}: the first parameter of {kernel.name} is not `first: int`")
    return faults


def test_kernels_are_at_module_scope_and_take_their_offset_first() -> None:
    faults = {str(path.relative_to(ROOT)): kernel_faults(path.read_text(encoding="utf-8")) for path in ALL}
    assert not {name: found for name, found in faults.items() if found}
    texts = [path.read_text(encoding="utf-8") for path in ALL]
    count = sum(1 for text in texts for _ in kernels_of(ast.parse(text)))
    assert count == sum(text.count("\n@wp.kernel") for text in texts) > 0


def test_kernel_faults_are_found() -> None:
    assert not kernel_faults("@wp.kernel\ndef k(first: int, x: float): pass\n")
    assert kernel_faults("@wp.kernel\ndef k(x: float, first: int): pass\n")
    assert kernel_faults("@wp.kernel(enable_backward=False)\ndef k(first: float): pass\n")
    assert kernel_faults("def f():\n    @wp.kernel\n    def k(first: int): pass\n")


def test_launches_go_through_one_door() -> None:
    """``wp.launch`` anywhere else would ignore the threads."""
    doors = {
        ROOT / "wkernels" / "device" / name for name in ("launch.py", "workers.py")
    }  # the second runs the threads themselves
    wrong = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in ALL
        if path not in doors
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("wp.launch", "wp.launch_tiled")
    ]
    assert not wrong, wrong


def test_no_file_names_a_package_registry() -> None:
    files = project_files()
    assert len(files) > 50
    wrong = []
    for path in files:
        content = path.read_bytes()
        wrong += [f"{path.relative_to(ROOT)}: {host}" for host in REGISTRIES if host.encode() in content]
    assert not wrong, wrong


def test_no_tracked_file_is_large() -> None:
    large = {
        str(path.relative_to(ROOT)): path.stat().st_size for path in project_files() if path.stat().st_size > 500_000
    }
    assert not large, large
