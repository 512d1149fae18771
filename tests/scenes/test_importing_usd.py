"""USD stages: centimetres with z up render as the same scene written by hand in metres with y up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_importing_gltf import same_visibility

from experiments.scenes import load_scene
from experiments.scenes.files import MeshWarning
from wkernels.errors import InputError

pytest.importorskip("pxr")

STAGE = """\
#usda 1.0
(
    upAxis = "Z"
    metersPerUnit = 0.01
    startTimeCode = 1
    endTimeCode = 11
    timeCodesPerSecond = 10
)
def Mesh "ground" {
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-600, -600, 0), (600, -600, 0), (600, 600, 0), (-600, 600, 0)]
}
def Xform "parent" {
    double3 xformOp:translate = (-200, 0, 100)
    double xformOp:rotateZ = 40
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
    def Cube "crate" {
        double size = 100
        color3f[] primvars:displayColor = [(0.5, 0.25, 0.125)]
    }
    def Cube "hidden" {
        double size = 900
        token visibility = "invisible"
    }
    def Cube "helper" {
        double size = 900
        uniform token purpose = "guide"
    }
}
def Cube "mover" {
    double size = 100
    double3 xformOp:translate.timeSamples = { 1: (0, -200, 100), 11: (300, -200, 100) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def SphereLight "lamp" {
        float inputs:radius = 10
        double3 xformOp:translate = (0, 0, 300)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
def PointInstancer "copies" {
    rel prototypes = </copies/one>
    int[] protoIndices = [0, 0]
    point3f[] positions = [(200, 200, 50), (200, 400, 50)]
    def Cube "one" {
        double size = 100
    }
}
def RectLight "panel" {
    float inputs:width = 200
    float inputs:height = 100
    double3 xformOp:translate = (0, 0, 600)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def DiskLight "disc" {
    float inputs:radius = 80
    double3 xformOp:translate = (0, 0, 600)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def DistantLight "sun" {
    float inputs:angle = 2
    float3 xformOp:rotateXYZ = (30, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
}
def CylinderLight "tube" {
    float inputs:length = 300
    bool treatAsLine = true
    double3 xformOp:translate = (0, 0, 500)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def DomeLight "sky" {
}
def Camera "eye" {
    float focalLength = 24
    float verticalAperture = 24
    float2 clippingRange = (50, 6000)
    double3 xformOp:translate = (0, -1000, 700)
    float3 xformOp:rotateXYZ = (55, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
}
def Camera "plan" {
    token projection = "orthographic"
    float verticalAperture = 8000
    float2 clippingRange = (50, 6000)
    double3 xformOp:translate = (0, 0, 900)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
KEYS = [{"frame": 0, "translate": [0, 1, 2]}, {"frame": 10, "translate": [3, 1, 2]}]
BOX = {"primitive": "box", "size": [1, 1, 1]}
BY_HAND: dict[str, Any] = {
    "meshes": [
        {"primitive": "plane", "size": [12, 12]},
        {**BOX, "transform": {"translate": [-2, 1, 0], "rotate_deg": [0, 40, 0]}},
        {**BOX, "motion": {"keyframes": KEYS}},
        {**BOX, "transform": {"translate": [2, 0.5, -2]}},
        {**BOX, "transform": {"translate": [2, 0.5, -4]}},
    ],
    "lights": [
        {"kind": "sphere", "center": [0, 3, 0], "radius": 0.1, "motion": {"keyframes": KEYS}},
        {"kind": "rectangle", "center": [0, 6, 0], "edge_u": [2, 0, 0], "edge_v": [0, 0, -1]},
        {"kind": "disc", "center": [0, 6, 0], "normal": [0, -1, 0], "radius": 0.8},
        # turned by 30 degrees about x, -z of the stage leans towards its +y, which is our -z
        {"kind": "directional", "direction": [0, -np.cos(np.radians(30)), -np.sin(np.radians(30))], "angle_deg": 2},
        {"kind": "linear", "a": [-1.5, 5, 0], "b": [1.5, 5, 0]},
    ],
    "camera": {
        "eye": [0, 7, 10],
        "target": [0, 7 - np.sin(np.radians(35)), 10 - np.cos(np.radians(35))],
        "fov_deg": float(np.degrees(2 * np.arctan(0.5))),
        "near": 0.5,
        "far": 60,
    },
}


@pytest.fixture
def stage(tmp_path: Path) -> dict[str, Any]:
    (tmp_path / "stage.usda").write_text(STAGE)
    return {"import": str(tmp_path / "stage.usda")}


@pytest.mark.filterwarnings("ignore:.*stage.usda")
@pytest.mark.parametrize("light", range(5))
def test_renders_as_the_scene_written_by_hand(stage: dict[str, Any], light: int) -> None:
    assert same_visibility(stage, BY_HAND, frame=6, light=light, samples=16) < 0.995


def test_what_came_in_and_what_did_not(stage: dict[str, Any]) -> None:
    with pytest.warns(UserWarning) as caught:
        scene = load_scene(stage)
    told = " ".join(str(one.message) for one in caught)
    for words in ("purpose guide", "that are invisible", "1 lights of type DomeLight"):
        assert words in told and any(words in note for note in scene.notes)
    assert any("up axis Z" in note for note in scene.notes) and any("0.01 m" in note for note in scene.notes)
    assert [mesh.name for mesh in scene.meshes] == ["ground", "crate", "mover", "one", "one_2"]
    assert scene.meshes[1].diffuse == (0.5, 0.25, 0.125)
    assert scene.frames == 11
    assert [light.kind for light in scene.lights] == ["sphere", "rectangle", "disc", "directional", "linear"]
    assert scene.light(0, 10).size == pytest.approx(0.2)
    assert scene.lights[1].radiance == (1.0, 1.0, 1.0)
    plan = load_scene({**stage, "camera": "plan"}).camera(0)
    assert plan.height == pytest.approx(8.0) and plan.far == pytest.approx(60)
    assert load_scene({**stage, "fps": 20}).frames == 21


def test_vertices_that_move(tmp_path: Path) -> None:
    from pxr import Gf, Usd, UsdGeom

    stage = Usd.Stage.CreateNew(str(tmp_path / "wave.usda"))
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(4)
    UsdGeom.SetStageUpAxis(stage, "Y")
    mesh = UsdGeom.Mesh.Define(stage, "/wave")
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1]])
    for time in (0, 4):
        mesh.CreatePointsAttr().Set([Gf.Vec3f(*p) for p in (points + np.array([0, time, 0])).tolist()], time)
    stage.Save()
    scene = load_scene(
        {
            "import": str(tmp_path / "wave.usda"),
            "camera": {"eye": [0, 5, 9], "target": [0, 0, 0]},
            "lights": [{"kind": "point", "position": [0, 4, 6]}],
        }
    )
    assert scene.frames == 5 and scene.meshes[0].moving
    np.testing.assert_allclose(scene.meshes[0].vertices_at(3), points + np.array([0, 3, 0]))


def skinned_stage(path: Path) -> None:
    """A triangle whose last vertex hangs on a joint that moves by 2 along x from time 0 to 2."""
    from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

    stage = Usd.Stage.CreateNew(str(path))
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(2)
    root = UsdSkel.Root.Define(stage, "/root")
    skeleton = UsdSkel.Skeleton.Define(stage, "/root/skeleton")
    identity = Vt.Matrix4dArray([Gf.Matrix4d(1.0)] * 2)
    skeleton.CreateJointsAttr(["low", "high"])
    skeleton.CreateBindTransformsAttr(identity)
    skeleton.CreateRestTransformsAttr(identity)
    animation = UsdSkel.Animation.Define(stage, "/root/animation")
    animation.CreateJointsAttr(["low", "high"])
    animation.CreateRotationsAttr([Gf.Quatf(1.0)] * 2)
    animation.CreateScalesAttr([Gf.Vec3h(1, 1, 1)] * 2)
    for time in (0, 2):
        animation.CreateTranslationsAttr().Set([Gf.Vec3f(0), Gf.Vec3f(time, 0, 0)], time)
    mesh = UsdGeom.Mesh.Define(stage, "/root/mesh")
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
    mesh.CreatePointsAttr([Gf.Vec3f(0, 0, 0), Gf.Vec3f(1, 0, 0), Gf.Vec3f(0, 1, 0)])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    UsdSkel.BindingAPI.Apply(root.GetPrim())
    binding.CreateJointIndicesPrimvar(False, 1).Set([0, 0, 1])
    binding.CreateJointWeightsPrimvar(False, 1).Set([1.0, 1.0, 1.0])
    stage.Save()


def test_skeletons(tmp_path: Path) -> None:
    skinned_stage(tmp_path / "skin.usda")
    before = (tmp_path / "skin.usda").read_bytes()
    scene = load_scene(
        {
            "import": str(tmp_path / "skin.usda"),
            "camera": {"eye": [0, 5, 9], "target": [0, 0, 0]},
            "lights": [{"kind": "point", "position": [0, 4, 6]}],
        }
    )
    np.testing.assert_allclose(scene.meshes[0].vertices_at(0), [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_allclose(scene.meshes[0].vertices_at(2), [[0, 0, 0], [1, 0, 0], [2, 1, 0]])
    assert (tmp_path / "skin.usda").read_bytes() == before  # the file itself is not written to


def test_a_mesh_file_tells_that_its_skeletons_are_not_applied(tmp_path: Path) -> None:
    skinned_stage(tmp_path / "skin.usda")
    scene = {
        "meshes": [{"file": str(tmp_path / "skin.usda")}],
        "camera": {"eye": [0, 5, 9], "target": [0, 0, 0]},
        "lights": [{"kind": "point", "position": [0, 4, 6]}],
    }
    with pytest.warns(MeshWarning, match="skeletons are not applied: 1 mesh is drawn at rest"):
        loaded = load_scene(scene)
    np.testing.assert_allclose(loaded.meshes[0].vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("metersPerUnit = 0.01", "metersPerUnit = -1"), "its unit is -1 m"),
        (("inputs:radius = 80", "inputs:radius = -3"), "the radius -3"),
        (("inputs:angle = 2", "inputs:angle = 200"), "the angle 200"),
        (("endTimeCode = 11", "endTimeCode = 1e12"), "more than 100000 frames"),
        (("def Mesh", "def def"), "cannot be read"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*stage.usda")
def test_broken_stages_are_refused(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    (tmp_path / "stage.usda").write_text(STAGE.replace(*change))
    with pytest.raises(InputError, match=message):
        load_scene({"import": str(tmp_path / "stage.usda")})
