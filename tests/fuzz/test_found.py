"""What fuzzing found once, each fault as a small file with its right answer."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from experiment_files import plugins
from mesh_seeds import binary_ply, seeds

from experiments.config.source import from_dict
from experiments.kinds.kind import kind_of_file, kind_of_folder
from experiments.results.sound import RunRecord, check_config, check_environment, check_table
from experiments.scenes import load_scene
from experiments.scenes.files import read_triangles
from experiments.scenes.place import Place
from experiments.scenes.sight import why_nothing_is_seen
from wkernels.errors import InputError

CASES = Path(__file__).parent / "cases"


def refused(path: Path, *, imported: bool = False) -> str:
    """The message about a file; one line."""
    with pytest.raises(InputError) as caught:
        if imported:
            load_scene({"import": str(path)})
        else:
            read_triangles(path.name, Place(from_dict({}), path.parent))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def gltf(folder: Path, change: Any, which: int = -4) -> Path:
    """A healthy glTF file with its JSON changed: -4 is a whole scene, -3 a skin, -2 morph targets."""
    found = [data for data in seeds()[".gltf"] if b"base64" in data]
    chosen = {
        -4: next(d for d in found if b'"cameras": [{' in d),
        -3: next(d for d in found if b"skins" in d),
        -2: next(d for d in found if b"targets" in d),
    }[which]
    data = json.loads(chosen)
    change(data)
    path = folder / "a.gltf"
    path.write_text(json.dumps(data))
    return path


GLTF = {
    # JSON null, another type, or no object where one must be
    "type of an accessor": (lambda d: d["accessors"][0].update(type=[3]), -4, "must be a text"),
    "kind of an accessor": (lambda d: d["accessors"][0].update(componentType={}), -4, "must be a whole number"),
    "material that is a list": (
        lambda d: d["meshes"][0]["primitives"][0].update(material=[0]),
        -4,
        "uses number [0] of its materials",
    ),
    "channel that is a text": (lambda d: d["animations"][0].update(channels=["x"]), -4, "channels must be objects"),
    "target that is a number": (lambda d: d["meshes"][0]["primitives"][0].update(targets=[7]), -2, "targets must be"),
    "children that are texts": (lambda d: d["nodes"][0].update(children=["x"]), -4, "children must be whole numbers"),
    "sparse without a view": (
        lambda d: d["accessors"][0].update(sparse={"count": 1, "indices": {"componentType": 5125}, "values": {}}),
        -4,
        "uses number None of its bufferViews",
    ),
    "number beyond float64": (lambda d: d["nodes"][0].update(translation=[10**308 * 10, 0, 0]), -4, "is not finite"),
}


@pytest.mark.parametrize("name", GLTF)
def test_gltf_of_wrong_types(tmp_path: Path, name: str) -> None:
    change, which, words = GLTF[name]
    assert words in refused(gltf(tmp_path, change, which), imported=True)


def test_a_null_in_gltf_is_a_key_that_is_missing(tmp_path: Path) -> None:
    """A reader that took it for a number stopped; some writers put it there."""

    def change(data: dict[str, Any]) -> None:
        for view in data["bufferViews"]:
            view.setdefault("byteOffset", 0)
        data["bufferViews"][0]["byteOffset"] = None
        data["nodes"][0]["name"] = None

    path = gltf(tmp_path, change)
    assert len(load_scene({"import": str(path)}).meshes) == 1


def test_ply_with_a_property_or_an_element_twice(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(binary_ply("<").replace(b"property double y\n", b"property double x\n"))
    assert "line 5: an element has the property 'x' twice" in refused(path)
    path.write_bytes(binary_ply("<").replace(b"element face 2", b"element vertex 2"))
    assert "has the element 'vertex' twice" in refused(path)


@pytest.mark.parametrize("length", ["nan", "inf", "1e30", "-1", "1.5"])
def test_ply_with_a_list_of_no_length(tmp_path: Path, length: str) -> None:
    path = tmp_path / "a.ply"
    text = (Path(__file__).parent / "seeds" / "sheet.ply").read_text()
    path.write_text(text.replace("4 0 3 2 1", f"{length} 0 3 2 1"))
    assert "line 14: a list has the length" in refused(path)


USD = {
    "up axis": ('upAxis = "Z"', 'upAxis = "W"', "has the up axis"),
    "time codes": ("timeCodesPerSecond = 10", "timeCodesPerSecond = 0", "has 0 time codes per second"),
    "type of a size": ("double size = 100", 'string size = "a"', "is of the type string, not double"),
    "type of a radius": ("float inputs:radius = 10", "token inputs:radius", "is of the type token, not float"),
}


@pytest.mark.parametrize("name", USD)
def test_usd_of_wrong_values(tmp_path: Path, name: str) -> None:
    pytest.importorskip("pxr")
    good, bad, words = USD[name]
    text = (Path(__file__).parent / "seeds" / "stage.usda").read_text()
    assert good in text
    path = tmp_path / "a.usda"
    path.write_text(text.replace(good, bad, 1))
    assert words in refused(path, imported=True)


def test_light_of_too_much_exposure(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    text = (Path(__file__).parent / "seeds" / "stage.usda").read_text()
    path = tmp_path / "a.usda"
    path.write_text(
        text.replace("float inputs:radius = 80", "float inputs:radius = 80\n    float inputs:exposure = 1e30")
    )
    assert "has the radiance inf" in refused(path, imported=True)


@pytest.mark.parametrize("path", sorted(CASES.glob("*.usd*")), ids=lambda path: path.name)
def test_binary_usd_that_ends_the_process(path: Path) -> None:
    """A flipped byte in an offset: USD's library reads beyond its buffer, in a process that is not ours."""
    pytest.importorskip("pxr")
    assert "cannot be read" in refused(path, imported=path.suffix == ".usdz")


def experiment(folder: Path, **techniques: Any) -> Path:
    data = {
        "kind": "walkthrough",
        "image": {"width": 16, "height": 9},
        "scene": {
            "meshes": [{"primitive": "plane", "size": [9, 9]}],
            "lights": [{"kind": "disc", "center": [0, 6, 0], "normal": [0, -1, 0], "radius": 1}],
            "camera": {"eye": [0, 6, 9], "target": [0, 0, 0]},
        },
        "techniques": [{name: params} for name, params in techniques.items()],
    }
    path = folder / "a.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


@pytest.mark.parametrize(
    ("techniques", "words"),
    [
        ({"blob_shadows": {"inner": 9.0}}, "outer must be more than inner"),  # a default that another value breaks
        ({"reference_multisample": {"sample_set": "~"}}, "'~' is not a valid name"),
    ],
)
def test_parameters_are_refused_before_anything_is_rendered(
    tmp_path: Path, techniques: dict[str, Any], words: str
) -> None:
    path = experiment(tmp_path, **techniques)
    with pytest.raises(InputError, match=words) as caught:
        kind_of_file(path).load(path, [], plugins())
    assert caught.value.line is not None


@pytest.mark.parametrize(
    ("mesh", "camera", "words"),
    [
        ({"primitive": "sphere", "radius": 5e-324}, {}, "radius: must be at least 1e-12"),
        ({"primitive": "box", "size": [1, 1, 1]}, {"fov_deg": 1e-158}, "fov_deg: must be at least 1e-06"),
    ],
)
def test_sizes_that_vanish_are_refused(mesh: dict[str, Any], camera: dict[str, Any], words: str) -> None:
    light = {"kind": "point", "position": [0, 5, 0]}
    scene = {"meshes": [mesh], "lights": [light], "camera": {"eye": [0, 2, 5], "target": [0, 0, 0], **camera}}
    with pytest.raises(InputError, match=words):
        load_scene(scene)


def test_the_narrowest_view_says_why_it_is_empty() -> None:
    scene = load_scene(
        {
            "meshes": [{"primitive": "plane", "size": [1e-12, 1e-12], "transform": {"translate": [50, 0, 0]}}],
            "lights": [{"kind": "point", "position": [0, 5, 0]}],
            "camera": {"eye": [0, 2, 5], "target": [0, 0, 0], "fov_deg": 1e-6},
        }
    )
    assert "outside the field of view" in why_nothing_is_seen(scene, 0, 16, 9)


# ---- result folders -------------------------------------------------------------------------------------------------

COLUMNS = ("technique", "label", "frame", "frame_ms", "rmse")
ROW = {"technique": "pcf", "label": "a", "frame": "0", "frame_ms": "1.5", "rmse": ""}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frame": ""}, "frames.csv:3: frame: must be a whole number, not ''"),
        ({"frame": "1e400"}, "frame: must be a whole number"),
        ({"frame": "99999999999999999999"}, "frame: must be a whole number"),
        ({"frame_ms": "x"}, "frame_ms: must be a number or empty, not 'x'"),
        ({"rmse": "nan"}, "rmse: must be a number or empty"),
        ({"label": "../x"}, "cannot be a label"),
        ({"label": "a\0"}, "cannot be a label"),
        ({"frame": "0"}, "frames.csv:3: is the same label and frame as line 2"),
    ],
)
def test_rows_that_no_run_writes(changes: dict[str, str], words: str) -> None:
    rows = [ROW, {**ROW, "frame": "1", **changes}]
    with pytest.raises(InputError) as caught:
        check_table("frames", rows, COLUMNS, Path("frames.csv"), ("label", "frame"))
    assert words in str(caught.value)
    check_table("frames", [ROW, {**ROW, "frame": "1"}], COLUMNS, Path("frames.csv"), ("label", "frame"))


def test_a_column_that_is_missing() -> None:
    rows = [{key: value for key, value in ROW.items() if key != "label"}]
    with pytest.raises(InputError, match="has no column 'label'"):
        check_table("frames", rows, COLUMNS, Path("frames.csv"), ("label", "frame"))


RECORD: dict[str, Any] = {
    "identity": {},
    "run": {"name": "a"},
    "environment": {"threads": 1, "device": "cpu", "device_name": "x"},
    "metrics": {"rmse": 1},
}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"run": []}, "run: must be an object"),
        ({"run": {}}, "run.name: is required"),
        ({"identity": 7}, "identity: must be a mapping"),
        ({"metrics": {"rmse": "one"}}, "metrics.rmse: must be a whole number"),
        ({"environment": {"threads": 1, "device": "cpu"}}, "environment.device_name: is required"),
    ],
)
def test_a_record_that_no_run_writes(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as caught:
        check_environment({**RECORD, **changes}, RunRecord, Path("environment.json"))
    assert words in str(caught.value)
    check_environment(RECORD, RunRecord, Path("environment.json"))


def test_a_scene_of_a_sweep_cannot_be_a_folder_elsewhere(tmp_path: Path) -> None:
    """A fresh run clears its scenes' folders: a name that leads out of the results would clear others."""
    from experiments.kinds.sweep.store import SweepStore

    scene = {"name": "../precious", "triangles": 2, "light": "disc", "frames": [0], "labels": [], "left_out": []}
    run = {"name": "a", "kind": "sweep", "width": 1, "height": 1, "reference_samples": None, "reference_light": None}
    run |= {"repeats": 1, "baseline": "a", "budgets": [], "labels": [], "scenes": [scene]}
    for folder in ("out", "precious"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "environment.json").write_text(json.dumps({**RECORD, "run": run}))
    with pytest.raises(InputError, match="cannot be the name of a folder"):
        SweepStore.open(tmp_path / "out", "", {}, resume=False)
    assert (tmp_path / "precious").is_dir()


@pytest.mark.parametrize(
    ("techniques", "words"),
    [("x", None), (7, "must be a list"), ([{"a": 1, "b": 2}], "techniques.0"), ([{"a": {"label": 7}}], "techniques.0")],
)
def test_a_configuration_that_no_run_writes(techniques: Any, words: str | None) -> None:
    if words is None:
        check_config({"techniques": techniques}, Path("config.yaml"))
        return
    with pytest.raises(InputError, match=words):
        check_config({"techniques": techniques}, Path("config.yaml"))


@pytest.mark.parametrize("record", ['{"run": []}', '{"run": {"kind": [1]}}', "{}"])
def test_the_kind_of_a_folder_whose_record_is_damaged(tmp_path: Path, record: str) -> None:
    (tmp_path / "environment.json").write_text(record)
    assert kind_of_folder(tmp_path).name == "walkthrough"
