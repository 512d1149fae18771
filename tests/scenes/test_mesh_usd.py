"""USD stages: what a renderer draws is drawn, where it stands; what is left out or turned is told."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from tests.scenes.mesh_cases import CASES, assert_same, read, solid, written
from wkernels.errors import InputError

pytest.importorskip("pxr")

USD = CASES / "usd"
PLAIN = read(USD / "plain.usda")
QUAD = (
    "int[] faceVertexCounts = [4]\n int[] faceVertexIndices = [0,1,2,3]\n"
    ' point3f[] points = [(-0.5,0,-0.5),(-0.5,0,0.5),(0.5,0,0.5),(0.5,0,-0.5)]\n uniform token subdivisionScheme = "none"\n'
)


def stage(folder: Path, text: str, head: str = ""):
    return read(written(folder, "a.usda", f"#usda 1.0\n({head})\n{text}"))


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("plain.usda", None),
        ("point_instancer.usda", None),
        ("guide.usda", r"left out: 1 prims of purpose guide"),
        ("z_up.usda", r"its up axis Z is turned to y"),
    ],
)
def test_cases_that_are_two_plates(name: str, told: str | None):
    if told is None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            mesh = read(USD / name)
    else:
        with pytest.warns(UserWarning, match=told):
            mesh = read(USD / name)
    assert_same(mesh, PLAIN)


def test_case_of_an_implicit_cube():
    vertices, faces = read(USD / "implicit.usda")
    cube = solid((vertices, faces[2:]))
    assert len(faces) == 14 and cube.volume == pytest.approx(0.8**3)
    np.testing.assert_allclose(solid((vertices, faces)).bounds, [[-1.5, 1, -0.5], [1.4, 2, 0.5]])


def test_case_of_time_samples():
    with pytest.warns(UserWarning, match="animated; it is drawn as at its first time sample"):
        vertices, _ = read(USD / "timesamples.usda")
    np.testing.assert_allclose(vertices[:4].mean(axis=0), [-1, 1, 0])


SHAPES = {
    'Sphere "s" { double radius = 2\n}': (4 / 3 * np.pi * 8, [4, 4, 4]),
    'Cylinder "s" { double radius = 1\n double height = 3\n uniform token axis = "X"\n}': (np.pi * 3, [3, 2, 2]),
    'Cone "s" { double radius = 1\n double height = 3\n uniform token axis = "Y"\n}': (np.pi, [2, 3, 2]),
    'Capsule "s" { double radius = 1\n double height = 3\n}': (np.pi * (3 + 4 / 3), [2, 2, 5]),
    'Cylinder_1 "s" { double radiusTop = 0\n double radiusBottom = 1\n double height = 3\n}': (np.pi, [2, 2, 3]),
    'Capsule_1 "s" { double radiusTop = 1\n double radiusBottom = 1\n double height = 3\n}': (
        np.pi * (3 + 4 / 3),
        [2, 2, 5],
    ),
    'Cube "s" { }': (8.0, [2, 2, 2]),
    'Sphere "s" { }': (4 / 3 * np.pi, [2, 2, 2]),
}


@pytest.mark.parametrize("text", SHAPES, ids=[text.partition(" ")[0] for text in SHAPES])
def test_implicit_shapes_are_closed_and_of_their_size(tmp_path: Path, text: str):
    shape = solid(stage(tmp_path, "def " + text))
    volume, size = SHAPES[text]
    assert shape.is_watertight
    assert shape.volume == pytest.approx(volume, rel=0.01)  # inscribed, so a little less
    np.testing.assert_allclose(shape.extents, size, rtol=2e-3)


def test_a_cone_points_along_its_axis(tmp_path: Path):
    vertices, _ = stage(tmp_path, 'def Cone "s" { double radius = 1\n double height = 2\n uniform token axis = "X"\n}')
    np.testing.assert_allclose(vertices[vertices[:, 0] > 0.5], [[1, 0, 0]], atol=1e-9)


@pytest.mark.parametrize(("axis", "size"), [("X", [0, 3, 2]), ("Y", [2, 0, 3]), ("Z", [2, 3, 0])])
def test_implicit_planes(tmp_path: Path, axis: str, size: list[float]):
    mesh = solid(
        stage(tmp_path, f'def Plane "s" {{ double width = 2\n double length = 3\n uniform token axis = "{axis}"\n}}')
    )
    np.testing.assert_allclose(mesh.extents, size)
    assert mesh.face_normals[0][" XYZ".index(axis) - 1] == pytest.approx(1.0)


def test_nested_and_masked_instancers_with_turned_instances_under_a_moved_parent(tmp_path: Path):
    inner = (
        'def PointInstancer "inner" {\n rel prototypes = [</top/outer/inner/q>]\n int[] protoIndices = [0, 0, 0]\n'
        " point3f[] positions = [(0,0,0),(2,0,0),(99,0,0)]\n int64[] invisibleIds = [2]\n"
        f'def Mesh "q" {{ {QUAD} }}\n}}\n'
    )
    outer = (
        'def PointInstancer "outer" {\n rel prototypes = [</top/outer/inner>]\n int[] protoIndices = [0, 0]\n'
        " point3f[] positions = [(0,0,0),(0,5,0)]\n quath[] orientations = [(1,0,0,0),(0.7071,0,0.7071,0)]\n"
        f"{inner}}}\n"
    )
    move = ' double3 xformOp:translate = (10,0,0)\n uniform token[] xformOpOrder = ["xformOp:translate"]\n'
    vertices, faces = stage(tmp_path, f'def Xform "top" {{\n{move}{outer}}}')
    middles = vertices[faces].reshape(-1, 6, 3).mean(axis=1).round(2)
    assert len(faces) == 8
    np.testing.assert_allclose(middles[:, 1], [0, 0, 5, 5], atol=0.01)
    centres = solid((vertices, faces)).triangles_center.reshape(4, 2, 3).mean(axis=1)
    np.testing.assert_allclose(centres, [[10, 0, 0], [12, 0, 0], [10, 5, 0], [10, 5, -2]], atol=0.01)


@pytest.mark.parametrize("purpose", ["default", "render", "proxy", "guide"])
def test_purposes(tmp_path: Path, purpose: str):
    text = f'def Mesh "a" {{ {QUAD} }}\ndef Xform "g" {{\n uniform token purpose = "{purpose}"\ndef Mesh "b" {{ {QUAD} }}\n}}'
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        drawn = len(stage(tmp_path, text)[1]) == 4
    assert drawn == (purpose in ("default", "render"))
    assert bool(told) == (not drawn)


def test_units_subdivision_curves_and_missing_layers_are_told(tmp_path: Path):
    smooth = QUAD.replace('"none"', '"catmullClark"')
    text = (
        f'def Mesh "a" {{ {smooth} }}\ndef BasisCurves "c" {{ }}\ndef "d" ( references = @./missing.usda@ ) {{ }}\n'
        'def RectLight "l" { }\ndef Camera "k" { }'
    )
    with pytest.warns(UserWarning) as told:
        stage(tmp_path, text, "metersPerUnit = 0.01")
    words = "\n".join(str(warning.message) for warning in told)
    for expected in (
        "its unit is 0.01 m; lengths are not scaled",
        "/a is a subdivision surface (catmullClark); its control mesh is drawn",
        "left out: 1 prims of type BasisCurves.",
        "missing.usda",
    ):
        assert expected in words


def test_faces_that_are_holes_are_not_drawn(tmp_path: Path):
    two = QUAD.replace("[4]", "[3, 3]").replace("[0,1,2,3]", "[0,1,2,0,2,3]")
    vertices, faces = stage(tmp_path, f'def Mesh "a" {{ {two} int[] holeIndices = [0]\n }}')
    assert_same((vertices, faces), (np.array([[-0.5, 0, -0.5], [0.5, 0, 0.5], [0.5, 0, -0.5]]), np.array([[0, 1, 2]])))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f'def Mesh "a" {{ {QUAD.replace("2,3]", "2,4]")} }}', r"a face of /a uses vertex 4, but they run from 0 to 3"),
        (f'def Mesh "a" {{ {QUAD.replace("[4]", "[5]")} }}', r"face counts do not fit"),
        (
            f'def Mesh "a" {{ {QUAD} double3 xformOp:scale = (1, nan, 1)\n'
            ' uniform token[] xformOpOrder = ["xformOp:scale"]\n }',
            r"the transform of /a is not finite",
        ),
        ('def Sphere "a" { double radius = inf\n}', r"Sphere /a has a size without a shape: radius inf"),
        ("def nonsense {", r"cannot be read"),
        (
            f'def PointInstancer "p" {{ rel prototypes = [</p/q>]\n int[] protoIndices = [1]\n point3f[] positions = [(0,0,0)]\n'
            f'def Mesh "q" {{ {QUAD} }}\n}}',
            r"an instance of /p uses",
        ),
    ],
)
def test_what_is_wrong_with_a_stage_is_named(tmp_path: Path, text: str, message: str):
    with pytest.raises(InputError, match=rf"a\.usda'.*{message}"):
        stage(tmp_path, text)


@pytest.mark.parametrize("text", ["# Grüße\n", '( doc = "Grüße" )\n', ""], ids=["comment", "doc", "byte order mark"])
def test_text_in_other_encodings_is_read_with_its_references(tmp_path: Path, text: str):
    written(tmp_path, "other.usda", f'#usda 1.0\n( defaultPrim = "a" )\ndef Mesh "a" {{ {QUAD} }}')
    stage_text = f'#usda 1.0\n{text}def "b" ( references = @./other.usda@ ) {{ }}\n'
    data = stage_text.encode("latin-1") if text else b"\xef\xbb\xbf" + stage_text.encode()
    assert len(read(written(tmp_path, "a.usda", data))[1]) == 2
