"""A warp, a fit or a stabiliser in one new file outside the tree is known to everything that names one.

Each copy has the formula of one of ours under another name, so that its pictures must be the same to the bit.
"""

from __future__ import annotations

import importlib.metadata
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from algorithms.modules import ROOT, import_file
from algorithms.plugins import load_all
from algorithms.projections import table
from algorithms.projections.composition import compose
from algorithms.projections.schema import PARTS, Projection, read_projection
from experiments import cli, render_visibility
from experiments.results.images import read_exr
from experiments.results.tables import read_table
from wkernels.errors import InputError

SCENE = """\
meshes:
- {primitive: plane, size: [4, 4]}
- {primitive: box, size: [1, 1, 1], transform: {translate: [0, 1, 0]}}
lights:
- {kind: directional, direction: [0.3, -1, 0.2]}
camera: {eye: [3, 3, 3], target: [0, 0, 0], fov_deg: 50, near: 0.1, far: 50}
"""
HEAD = "kind: walkthrough\nscene: scene.yaml\nimage: {width: 64, height: 48}\ntechniques:\n- shadow_map: {resolution: 32}\n"
ORIGINALS = {"fit": "fits/focused", "warp": "warps/psm", "stabilise": "stabilisers/exact"}
PLAIN: dict[str, dict[str, Any]] = {"fit": {}, "warp": {"fit": "focused"}, "stabilise": {"fit": "focused"}}


def copied(folder: Path, key: str, name: str) -> Path:
    """One of our parts under another name, in a file of that name."""
    original = ROOT / "projections" / f"{ORIGINALS[key]}.py"
    text = original.read_text(encoding="utf-8").replace(f'name = "{original.stem}"', f'name = "{name}"')
    path = folder / f"{name}.py"
    path.write_text(text, encoding="utf-8")
    return path


def run(folder: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))
    monkeypatch.setattr(sys, "argv", ["wkernels", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return int(ended.value.code or 0)


@pytest.mark.parametrize("key", PARTS)
def test_a_real_run_takes_a_part_from_outside(
    key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name, original = f"outside_{key}", Path(ORIGINALS[key]).name
    copied(tmp_path, key, name)
    (tmp_path / "scene.yaml").write_text(SCENE)
    entries = [
        f"- shadow_map: {{label: {label}, resolution: 32, projection: {json.dumps({**PLAIN[key], **changed})}}}\n"
        for label, changed in (("ours", {key: original}), ("outside", {key: name}))
    ]
    (tmp_path / "e.yaml").write_text(HEAD + "".join(entries))
    assert run(tmp_path, monkeypatch, "run", "e.yaml") == 2
    assert f"projection.{key}: '{name}' is not a valid name." in (err := capsys.readouterr().err)
    assert err.startswith("error: e.yaml:7: techniques.2.shadow_map.projection") and err.count("\n") == 1
    assert run(tmp_path, monkeypatch, "run", "e.yaml", "--plugin", f"{name}.py") == 0, capsys.readouterr().err
    plain, ours, outside = (
        read_exr(tmp_path / "out" / "e" / "images" / label / "visibility_0000.exr")
        for label in ("shadow_map", "ours", "outside")
    )
    assert np.array_equal(ours, outside, equal_nan=True) and not np.array_equal(plain, ours, equal_nan=True)
    identity = json.loads((tmp_path / "out" / "e" / "environment.json").read_text())["identity"]
    folder = Path(ORIGINALS[key]).parent.as_posix()
    assert f"plugin {folder}/{name}" in identity, "rows of another version of the file must not be mixed in"


def test_python_calls_take_them_too(tmp_path: Path) -> None:
    path, scene = copied(tmp_path, "warp", "warp_of_a_call"), tmp_path / "scene.yaml"
    scene.write_text(SCENE)
    options: dict[str, Any] = {"params": {"resolution": 64}, "width": 24, "height": 18}
    given = {"fit": "focused", "warp": "warp_of_a_call"}
    with pytest.raises(InputError, match=r"projection\.warp: 'warp_of_a_call' is not"):
        render_visibility(scene, "shadow_map", projection=given, **options)
    outside = render_visibility(scene, "shadow_map", projection=given, plugins=[path], **options)
    ours = render_visibility(scene, "shadow_map", projection={**given, "warp": "psm"}, **options)
    assert np.array_equal(ours.visibility, outside.visibility, equal_nan=True)


def test_an_analysis_takes_a_warp_from_outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copied(tmp_path, "warp", "warp_of_a_curve")
    (tmp_path / "a.yaml").write_text(
        "kind: analysis\ncamera: {fov_deg: 60, near: 1, far: 40}\n"
        "curves: [{label: ours, warp: psm}, {label: outside, warp: warp_of_a_curve}]\n"
    )
    assert run(tmp_path, monkeypatch, "run", "a.yaml", "--out", "o", "--plugin", "warp_of_a_curve.py") == 0
    rows = read_table(tmp_path / "o" / "analysis.csv")
    ours, outside = ([row["m_z"] for row in rows if row["label"] == label] for label in ("ours", "outside"))
    assert ours and ours == outside


def test_an_installed_package_may_bring_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = import_file(copied(tmp_path, "warp", "installed_warp"))

    class Entry:
        name = value = "installed_warp"

        def load(self) -> object:
            return module

    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [Entry()] if "algorithms" in group else [])
    table._installed.cache_clear()
    try:
        assert "installed_warp" in table.warps() and "installed_warp" not in load_all()
        compose({"fit": "focused", "warp": "installed_warp"})
    finally:
        table._installed.cache_clear()


BAD = {
    "nothing_of_ours": (
        "warp",
        lambda text: text.replace("nothing_of_ours", "another_name"),
        r"holds \['another_name'\]",
    ),
    "two_parts": (
        "warp",
        lambda text: text + text[text.index("class ") :].replace("class Psm", "class Other"),
        "holds",
    ),
    "no_method": ("warp", lambda text: text.replace("def distance", "def length"), "does not implement `distance`"),
    "lispsm_nopt": ("warp", lambda text: text, r"'lispsm_nopt' exists already, in .*lispsm_nopt\.py"),
    "focused": ("fit", lambda text: text, r"'focused' exists already, in .*focused\.py"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_by_name(name: str, tmp_path: Path) -> None:
    key, change, message = BAD[name]
    path = copied(tmp_path, key, name)
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=message) as caught:
        load_all([path])
    assert caught.value.file == str(path)


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    paths = [copied(tmp_path, "warp", "twice"), copied(tmp_path / "b", "warp", "twice")]
    with pytest.raises(InputError, match="'twice' exists already"):
        load_all(paths)


def test_files_that_begin_with_an_underscore_are_helpers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in table.KINDS:
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "_helper.py").write_text("raise RuntimeError\n")
    monkeypatch.setattr(table, "FOLDER", tmp_path)
    assert "psm" not in table.warps() and not any(name.startswith("_") for name in table.fits())


def test_every_key_says_what_it_is() -> None:
    keys = Projection.model_json_schema()["properties"]
    assert list(keys) == list(Projection().written()) and len(keys) == 17
    assert all(key["description"] and key["unit"] for key in keys.values())
    for key, names in (("fit", table.fits()), ("warp", table.warps()), ("stabilise", ["none", *table.stabilisers()])):
        assert keys[key]["enum"] == list(names)
    assert read_projection({}) == Projection() and not Projection().changed()
    assert read_projection({"fit": "focused", "lambda": 1.0}).changed() == {"fit": "focused", "lambda": 1.0}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lambda": 1.5}, "projection.lambda: 1.5 is not available; available: 0 to 1."),
        ({"warp_distance": 0.0}, "projection.warp_distance: 0.0 is not available; available: numbers above 0 or None."),
        ({"splits": 2.0}, "projection.splits: 2.0 is not available; available: 1 to 16."),
    ],
)
def test_values_out_of_range_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        compose(settings)
    assert str(caught.value) == message
