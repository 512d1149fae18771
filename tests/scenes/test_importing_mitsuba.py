"""Mitsuba XML: renders as the same scene written by hand; what is wrong is refused with its line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_importing_gltf import same_visibility

from experiments.scenes import load_scene
from wkernels.errors import InputError

SCENE = """\
<scene version="3.0.0">
  <default name="height" value="6"/>
  <bsdf type="twosided" id="red"><bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.25, 0.125"/></bsdf></bsdf>
  <sensor type="perspective" id="eye">
    <float name="fov" value="60"/>
    <float name="near_clip" value="0.5"/>
    <float name="far_clip" value="60"/>
    <transform name="to_world"><lookat origin="0, 7, 10" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="640"/><integer name="height" value="400"/></film>
  </sensor>
  <sensor type="orthographic" id="plan">
    <transform name="to_world">
      <scale value="8"/>
      <lookat origin="0, 9, 0" target="0, 0, 0" up="0, 0, -1"/>
    </transform>
    <film type="hdrfilm"><integer name="width" value="640"/><integer name="height" value="400"/></film>
  </sensor>
  <shape type="rectangle" id="ground">
    <transform name="to_world"><scale value="6"/><rotate x="1" angle="-90"/></transform>
    <ref id="red"/>
  </shape>
  <shape type="cube" id="crate">
    <transform name="to_world">
      <scale x="0.5" y="0.5" z="0.5"/><rotate y="1" angle="40"/><translate x="-2" y="1"/>
    </transform>
  </shape>
  <shape type="ply" id="sheet"><string name="filename" value="sheet.ply"/></shape>
  <shape type="shapegroup" id="group">
    <shape type="sphere"><float name="radius" value="0.5"/><point name="center" x="0" y="1" z="0"/></shape>
  </shape>
  <shape type="instance"><ref id="group"/><transform name="to_world"><translate x="3" z="-2"/></transform></shape>
  <shape type="rectangle" id="panel">
    <transform name="to_world"><scale x="1" y="0.5"/><rotate x="1" angle="90"/><translate y="$height"/></transform>
    <emitter type="area"><rgb name="radiance" value="3 2 1"/></emitter>
  </shape>
  <shape type="sphere" id="ball">
    <point name="center" x="0" y="5" z="0"/><float name="radius" value="0.25"/>
    <emitter type="area"/>
  </shape>
  <shape type="disk" id="dish">
    <transform name="to_world"><scale value="0.8"/><rotate x="1" angle="90"/><translate y="$height"/></transform>
    <emitter type="area"/>
  </shape>
  <emitter type="point"><point name="position" value="0, 6, 1"/></emitter>
  <emitter type="directional"><vector name="direction" x="1" y="-2" z="0"/></emitter>
  <emitter type="constant"/>
  <shape type="hair"><string name="filename" value="none.txt"/></shape>
</scene>
"""
PLY = """\
ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 1 2
2 1 2
2 1 3
0 1 3
4 0 3 2 1
"""
BY_HAND: dict[str, Any] = {
    "meshes": [
        {"primitive": "plane", "size": [12, 12]},
        {"primitive": "box", "size": [1, 1, 1], "transform": {"translate": [-2, 1, 0], "rotate_deg": [0, 40, 0]}},
        {"primitive": "plane", "size": [2, 1], "transform": {"translate": [1, 1, 2.5]}},
        {"primitive": "sphere", "radius": 0.5, "subdivisions": 4, "transform": {"translate": [3, 1, -2]}},
    ],
    "lights": [
        {"kind": "rectangle", "center": [0, 6, 0], "edge_u": [2, 0, 0], "edge_v": [0, 0, 1], "radiance": [3, 2, 1]},
        {"kind": "sphere", "center": [0, 5, 0], "radius": 0.25},
        {"kind": "disc", "center": [0, 6, 0], "normal": [0, -1, 0], "radius": 0.8},
        {"kind": "point", "position": [0, 6, 1]},
        {"kind": "directional", "direction": [1, -2, 0]},
    ],
    "camera": {
        "eye": [0, 7, 10],
        "target": [0, 0, 0],
        "fov_deg": float(2 * np.degrees(np.arctan(np.tan(np.radians(30)) / 1.6))),
        "near": 0.5,
        "far": 60,
    },
}


def write(folder: Path, text: str = SCENE) -> dict[str, Any]:
    (folder / "sheet.ply").write_text(PLY)
    (folder / "city.xml").write_text(text)
    return {"import": str(folder / "city.xml")}


@pytest.mark.filterwarnings("ignore:.*city.xml")
@pytest.mark.parametrize("light", range(5))
def test_renders_as_the_scene_written_by_hand(tmp_path: Path, light: int) -> None:
    assert same_visibility(write(tmp_path), BY_HAND, light=light, samples=16) < 0.98


def test_what_came_in_and_what_did_not(tmp_path: Path) -> None:
    with pytest.warns(UserWarning) as caught:
        scene = load_scene(write(tmp_path))
    told = " ".join(str(one.message) for one in caught)
    for words in ("1 emitters of type constant", "1 shapes of type hair"):
        assert words in told and any(words in note for note in scene.notes)
    assert [mesh.name for mesh in scene.meshes] == ["ground", "crate", "sheet", "sphere"]
    assert scene.meshes[0].diffuse == (0.5, 0.25, 0.125)
    assert scene.lights[0].radiance == (3.0, 2.0, 1.0)
    plan = load_scene({**write(tmp_path), "camera": "plan"}).camera(0)
    assert plan.height == pytest.approx(10.0)
    np.testing.assert_allclose(plan.target - plan.eye, [0, -1, 0], atol=1e-12)


def test_includes_are_read(tmp_path: Path) -> None:
    head, rest = SCENE.split("  <shape", 1)
    (tmp_path / "rest.xml").write_text('<scene version="3.0.0">\n  <shape' + rest)
    keys = write(tmp_path, head + '<include filename="rest.xml"/></scene>')
    with pytest.warns(UserWarning):
        assert len(load_scene(keys).meshes) == 4


def test_focal_length_is_of_35_mm_film(tmp_path: Path) -> None:
    text = SCENE.replace('<float name="fov" value="60"/>', '<string name="focal_length" value="50mm"/>')
    with pytest.warns(UserWarning):
        fov = load_scene(write(tmp_path, text)).camera(0).fov_deg
    diagonal = np.hypot(36, 24) / 100
    assert np.tan(np.radians(fov / 2)) == pytest.approx(diagonal / np.hypot(1, 1.6))


@pytest.mark.filterwarnings("ignore:.*city.xml")
def test_scenes_of_version_2_are_those_of_version_3(tmp_path: Path) -> None:
    new = load_scene(write(tmp_path, SCENE))
    assert load_scene(write(tmp_path, SCENE.replace("3.0.0", "2.1.0"))).content_hash == new.content_hash


@pytest.mark.filterwarnings("ignore:.*city.xml")
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("<scene ", "<!DOCTYPE a [<!ENTITY x 'xx'>]><scene "), "line 1: declares a document type"),
        (('<ref id="red"/>', '<ref id="rad"/>'), r"line 20: refers to 'rad'.*red"),
        (("$height", "$heihgt"), r"line 33: \$heihgt has no default.*height"),
        (('value="0.25"', 'value="nan"'), "line 37: 'nan' is not finite"),
        (('value="0.25"', 'value="big"'), "line 37: 'big' is no number"),
        (("sheet.ply", "shed.ply"), "line 27: no such file"),
        (("3.0.0", "0.6.0"), "version 0.6.0"),
        (("</scene>", ""), "is no XML"),
        (('value="60"/>', 'value="190"/>'), "field of view is 190"),
        (('angle="40"', 'angel="40"'), "needs the attribute angle"),
    ],
)
def test_mistakes_are_named_with_their_line(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_scene(write(tmp_path, SCENE.replace(*change)))
