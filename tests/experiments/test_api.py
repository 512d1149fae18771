"""The Python calls: ``render_visibility`` and ``reference_visibility``."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import experiments
from algorithms.plugins import load_all
from algorithms.projections.composition import compose
from algorithms.projections.table import FOLDER, fits, stabilisers, warps
from experiments import reference_visibility, render_visibility
from experiments.scenes import load_scene
from wkernels.errors import InputError
from wkernels.frame.session import Session
from wkernels.scene.geometry import Geometry

SIZE: dict[str, Any] = {"width": 40, "height": 30}
SCENE: dict[str, Any] = {
    "meshes": [
        {"primitive": "plane", "size": [20, 20]},
        {"primitive": "box", "size": [1, 1, 1], "transform": {"translate": [0, 1.5, 0]}},
        {
            "primitive": "sphere",
            "radius": 0.5,
            "name": "ball",
            "motion": {"keyframes": [{"frame": 0, "translate": [-2, 1, 0]}, {"frame": 4, "translate": [2, 1, 0]}]},
        },
    ],
    "lights": [
        {"kind": "rectangle", "center": [0, 6, 0], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1]},
        {"kind": "point", "position": [1, 6, 0]},
    ],
    "camera": {"eye": [0, 4, 6], "target": [0, 0, 0], "fov_deg": 55, "near": 0.1, "far": 50},
}

COUNTER = '''"""Visibility that says how the frame was reached; nothing is wrong with it but everything. Known artefacts: all."""
import warp as wp
from algorithms.technique import Needs, Params, Technique, setting

class FrameCounter(Technique):
    """Frames since the start, and the index of this one."""
    name = "frame_counter"
    family = "temporal"
    paper = ()
    bias_sign = "none"
    needs = Needs(history=True)

    class Params(Params):
        scale: float = setting(1.0, "factor", unit="1", ge=0.0, le=10.0)

    def render(self, frame):
        visibility = frame.visibility_buffer(frame.gbuffer())
        visibility.fill_(self.params.scale * (100.0 * frame.count + frame.index))
        return visibility
'''


def test_frame_result() -> None:
    result = render_visibility(SCENE, "shadow_map", **SIZE)
    assert result.visibility.shape == (30, 40) and result.visibility.dtype == np.float32
    assert result.world_position.shape == (30, 40, 3) and result.world_position.dtype == np.float32
    seen = np.isfinite(result.visibility)
    assert set(np.unique(result.visibility[seen])) == {0.0, 1.0}
    assert np.isfinite(result.world_position[seen]).all()
    assert result.color.shape == (30, 40, 3)
    assert result.standard_error is None
    assert result.frame_ms > 0.0


def test_sampling_technique_reports_its_error() -> None:
    result = render_visibility(SCENE, "reference_multisample", {"samples": 16}, **SIZE)
    v, se = reference_visibility(SCENE, samples=16, cache=False, **SIZE)
    assert np.array_equal(result.visibility, v, equal_nan=True)
    assert np.array_equal(result.standard_error, se, equal_nan=True)


def test_scene_may_be_file_dict_or_loaded(tmp_path: Path) -> None:
    import yaml

    file = tmp_path / "scene.yaml"
    file.write_text(yaml.safe_dump(SCENE), encoding="utf-8")
    images = [
        render_visibility(source, "shadow_map", **SIZE).visibility
        for source in (SCENE, file, str(file), load_scene(SCENE))
    ]
    assert all(np.array_equal(images[0], image, equal_nan=True) for image in images[1:])


def test_light_frame_and_seed_are_used() -> None:
    def render(technique: str = "reference_multisample", **changed: Any) -> np.ndarray:
        params = {"samples": 5} if technique == "reference_multisample" else None
        return render_visibility(SCENE, technique, params, **{**SIZE, **changed}).visibility

    plain = render()
    for changed in ({"light": 1}, {"frame": 2}, {"seed": 2}):
        assert not np.array_equal(plain, render(**changed), equal_nan=True), changed
    for changed in ({"threads": 1}, {"skips": False}):
        assert np.array_equal(plain, render(**changed), equal_nan=True), changed
    assert np.array_equal(render(frame=4), render(frame=400), equal_nan=True), "motion holds its end"


@pytest.fixture
def counter(tmp_path: Path) -> Path:
    file = tmp_path / "frame_counter.py"
    file.write_text(COUNTER, encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("frame", "frames", "expected"), [(0, 1, 0.0), (3, 1, 3.0), (3, 3, 203.0), (1, 4, 301.0), (0, 3, 200.0)]
)
def test_frames_lead_up_to_the_last(counter: Path, frame: int, frames: int, expected: float) -> None:
    result = render_visibility(SCENE, "frame_counter", frame=frame, frames=frames, plugins=[counter], **SIZE)
    assert np.nanmax(result.visibility) == np.nanmin(result.visibility) == expected


def test_params_and_plugin_table(counter: Path) -> None:
    table = load_all([counter])
    result = render_visibility(SCENE, "frame_counter", {"scale": 0.25}, frame=2, plugins=table, **SIZE)
    assert np.nanmax(result.visibility) == 0.5


def test_projection_scene_is_the_default() -> None:
    plain = render_visibility(SCENE, "shadow_map", **SIZE)
    asked = render_visibility(SCENE, "shadow_map", projection={"fit": "scene", "warp": "none", "splits": 1}, **SIZE)
    assert np.array_equal(plain.visibility, asked.visibility, equal_nan=True)
    assert (plain.m_x_max, plain.m_z_max) == (asked.m_x_max, asked.m_z_max)


def test_composed_projection_reaches_the_light_map() -> None:
    seen: list[int] = []

    def spy(light_ws: np.ndarray, receivers: Any, casters: Any, resolution: int, eye: Any) -> Any:
        seen.append(resolution)
        return compose()(light_ws, receivers, casters, resolution, eye)

    session = Session(Geometry(load_scene(SCENE)), projection=spy, **SIZE)
    session.render(load_all()["shadow_map"]())
    assert seen == [1024]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"fit": "tight"}, r"projection.fit: 'tight' is not available; available: focused, scene"),
        ({"warp": "psn"}, r"projection.warp: 'psn' is not available; available: arbitrary, lispsm_nopt"),
        ({"warp": "psm"}, r"projection.warp: 'psm' needs a fit that follows the eye \(focused\)"),
        ({"splits": 4}, r"projection.splits: 4 needs a fit that follows the eye"),
        ({"fit": "focused", "splits": 17}, r"projection.splits: 17 is not available; available: 1 to 16"),
        ({"splits": True}, r"projection.splits: True is not available"),
        ({"stabilise": "exact"}, r"projection.stabilise: 'exact' needs a fit that follows the eye"),
        ({"fit": "focused", "warp": "psm", "stabilise": "exact"}, r"projection.stabilise: cannot stabilise a warp"),
        ({"fit": "focused", "splits": 5, "storage": "cube6"}, r"projection.storage: 'cube6' has 6 places"),
        ({"fit": "focused", "splits": 5, "storage": "atlas4"}, r"projection.storage: 'atlas4' has 4 places"),
        ({"fit": "focused", "splits": 10, "storage": "atlas9"}, r"projection.storage: 'atlas9' has 9 places"),
        ({"fit": "focused", "storage": "cube6"}, r"projection.storage: 'cube6' has 6 places"),
        ({"drawing": "clone"}, r"projection.drawing: 'clone' is not available; available: passes, cloned, instanced"),
        ({"fit": "focused", "warp": "arbitrary"}, r"projection.warp_distance: is required by"),
        ({"fit": "focused", "warp_distance": 2.0}, r"projection.warp_distance: needs the warp 'arbitrary'"),
        ({"fit": "focused", "pseudo_far": 0.1}, r"projection.pseudo_far: needs the scheme 'pseudo'"),
        (
            {"fit": "focused", "scheme": "pseudo", "pseudo_near": 0.4, "pseudo_far": 0.6},
            r"projection.pseudo_near: pseudo_near and pseudo_far together must be less than 1",
        ),
        ({"ftt": "scene"}, r"projection.ftt: is not a known key. Did you mean 'fit'"),
    ],
)
def test_projection_table_says_what_exists(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        compose(settings)


def test_projection_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder, table in (("fits", fits()), ("warps", warps()), ("stabilisers", stabilisers())):
        assert set(table) == {path.stem for path in (FOLDER / folder).glob("*.py")} - {"__init__"}
        assert table and all(part.name == name and part.paper for name, part in table.items())
    (tmp_path / "fits").mkdir()
    (tmp_path / "fits" / "absent.py").write_text("", encoding="utf-8")
    monkeypatch.setattr("algorithms.projections.table.FOLDER", tmp_path)
    with pytest.raises(InputError, match=r"absent\.py: cannot be imported"):
        compose()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"technique": "shadow_mop"}, "unknown technique 'shadow_mop'. Did you mean 'shadow_map'"),
        ({"technique": "shadow_mop", "plugins": {"shadow_map": object}}, "Did you mean 'shadow_map'"),
        ({"params": {"resolutoin": 512}}, "params.resolutoin: is not a known key. Did you mean 'resolution'"),
        ({"params": {"resolution": 0}}, "params.resolution: must be at least 1, not 0"),
        ({"params": {"resolution": "512"}}, "params.resolution: must be a whole number"),
        ({"params": {"bias_slope": float("nan")}}, "params.bias_slope"),
        ({"projection": {"fit": "tight"}}, "projection.fit: 'tight' is not"),
        ({"projection": {"splits": 4}}, "projection.splits: 4 needs a fit that follows the eye"),
        ({"projection": {"split": 1}}, "projection.split: is not a known key. Did you mean 'splits'"),
        ({"width": 0}, "width: must be a whole number from 1 to 16384, not 0"),
        ({"height": -3}, "height: must be a whole number from 1"),
        ({"width": 10.5}, "width: must be a whole number"),
        ({"frame": -1}, "frame: must be a whole number at least 0, not -1"),
        ({"frames": 0}, "frames: must be a whole number at least 1, not 0"),
        ({"seed": -1}, "seed: must be a whole number from 0"),
        ({"seed": 2**31}, "seed: must be a whole number from 0 to 2147483647"),
        ({"threads": 0}, "threads: must be a whole number at least 1"),
        ({"light": 2}, r"light: the scene has 2 light\(s\); there is no light 2"),
        ({"device": "cuda:77"}, "there is no device 'cuda:77'"),
        ({"scene": "no/such/scene.yaml"}, "no/such/scene.yaml: no such file"),
        ({"scene": {**SCENE, "lihgts": []}}, "lihgts: is not a known key. Did you mean 'lights'"),
    ],
)
def test_wrong_arguments(changed: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {"scene": SCENE, "technique": "shadow_map", **SIZE, **changed}
    with pytest.raises(InputError, match=message):
        render_visibility(**arguments)


@pytest.mark.parametrize("changed", [{"width": 0}, {"samples": 0}, {"light": 9}, {"frame": -1}, {"device": "gpu"}])
def test_wrong_arguments_of_the_reference(changed: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(changed))):
        reference_visibility(SCENE, cache=False, **{**SIZE, **changed})


def test_technique_that_needs_an_area_is_refused_a_point(tmp_path: Path) -> None:
    file = tmp_path / "frame_counter.py"
    file.write_text(COUNTER.replace("Needs(history=True)", "Needs(area=True)"), encoding="utf-8")
    table = {"frame_counter": load_all([file])["frame_counter"]}
    with pytest.raises(InputError, match="needs a light with an area"):
        render_visibility(SCENE, "frame_counter", light=1, plugins=table, **SIZE)


def test_package_exports_are_lazy() -> None:
    code = "import sys, experiments; print('warp' in sys.modules, sorted(experiments.__all__), 'numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False ['reference_visibility', 'render_visibility'] False"
    assert set(experiments.__all__) <= set(dir(experiments))
    with pytest.raises(AttributeError, match="no attribute 'render'"):
        experiments.render  # noqa: B018
