"""COLLADA: polygons with holes, concave ones, strips, the up axis; what is wrong is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.scenes.mesh_cases import assert_same, coverage, read, solid, written
from tests.scenes.test_mesh_dialects import TRIANGLES
from tests.scenes.test_mesh_polygons import DOOR, POINTS, in_door
from wkernels.errors import InputError

pytest.importorskip("collada")


def dae(folder: Path, vertices: np.ndarray, primitives: str, up: str = "Y_UP", unit: str = "1", node: str = ""):
    numbers = " ".join(f"{x:g}" for x in np.ravel(vertices))
    text = f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2020-01-01T00:00:00</created><modified>2020-01-01T00:00:00</modified>
<unit name="u" meter="{unit}"/><up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="{np.size(vertices)}">{numbers}</float_array><technique_common>
<accessor source="#pa" count="{len(vertices)}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
{primitives}
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node>{node}<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
    return read(written(folder, "a.dae", text))


INPUT = '<input semantic="VERTEX" source="#v" offset="0"/>'
PLATES = TRIANGLES[0]
QUADS = f'<polylist count="2">{INPUT}<vcount>4 4</vcount><p>0 1 2 3 4 5 6 7</p></polylist>'
FLAT_DOOR = np.c_[DOOR, np.zeros(8)]


@pytest.mark.parametrize(
    "primitives",
    [
        QUADS,
        f'<triangles count="4">{INPUT}<p>0 1 2 0 2 3 4 5 6 4 6 7</p></triangles>',
        f'<polygons count="2">{INPUT}<p>0 1 2 3</p><p>4 5 6 7</p></polygons>',
        f'<trifans count="2">{INPUT}<p>0 1 2 3</p><p>4 5 6 7</p></trifans>',
        f'<polylist count="1">{INPUT}<vcount>4</vcount><p>0 1 2 3</p></polylist>'
        f'<triangles count="2">{INPUT}<p>4 5 6 4 6 7</p></triangles>',
        f'<polylist count="2">{INPUT}<input semantic="NORMAL" source="#p" offset="1"/><vcount>4 4</vcount>'
        "<p>0 0 1 0 2 0 3 0 4 0 5 0 6 0 7 0</p></polylist>",
    ],
)
def test_primitives_of_every_kind(tmp_path: Path, primitives: str):
    assert_same(dae(tmp_path, PLATES, primitives), TRIANGLES)


@pytest.mark.parametrize(
    "primitives",
    [
        f'<polylist count="1">{INPUT}<vcount>8</vcount><p>0 1 2 3 4 5 6 7</p></polylist>',
        f'<polygons count="1">{INPUT}<p>0 1 2 3 4 5 6 7</p></polygons>',
    ],
)
def test_concave_polygons(tmp_path: Path, primitives: str):
    mesh = dae(tmp_path, FLAT_DOOR, primitives)
    np.testing.assert_array_equal(coverage(mesh, POINTS), in_door(POINTS))


@pytest.mark.parametrize("others", ["", "<p>0 1 2</p>"])
def test_polygons_with_holes(tmp_path: Path, others: str):
    outline = np.array([[0, 0], [4, 0], [4, 4], [0, 4], [1, 1], [2, 1], [2, 3], [1, 3]], float)
    mesh = solid(
        dae(
            tmp_path,
            np.c_[outline, np.zeros(8)],
            f'<polygons count="1">{INPUT}{others}<ph><p>0 1 2 3</p><h>4 5 6 7</h></ph></polygons>',
        )
    )
    assert mesh.area == pytest.approx(14.0 + (8.0 if others else 0.0))


@pytest.mark.parametrize(
    ("up", "turned"),
    [
        ("Y_UP", lambda v: v),
        ("Z_UP", lambda v: v[:, [0, 2, 1]] * [1, -1, 1]),
        ("X_UP", lambda v: v[:, [1, 0, 2]] * [1, -1, 1]),
    ],
)
def test_the_up_axis_is_turned_and_told(tmp_path: Path, up: str, turned, recwarn):
    assert_same(dae(tmp_path, turned(PLATES), QUADS, up=up), TRIANGLES)
    assert [up[0] in str(w.message) for w in recwarn if "up axis" in str(w.message)] == [True] * (up != "Y_UP")


def test_units_and_lines_are_told(tmp_path: Path):
    lines = f'<lines count="1">{INPUT}<p>0 1</p></lines>'
    with pytest.warns(UserWarning) as told:
        assert_same(dae(tmp_path, PLATES, QUADS + lines, unit="0.01"), TRIANGLES)
    words = " ".join(str(warning.message) for warning in told)
    assert "its unit is 0.01 m; lengths are not scaled" in words and "left out: LineSet of geometry g" in words


def test_a_node_that_mirrors_keeps_the_outside(tmp_path: Path):
    mesh = dae(tmp_path, PLATES, QUADS, node="<scale>-1 1 1</scale>")
    assert np.all(solid(mesh).face_normals[:, 1] > 0.99)


@pytest.mark.parametrize(
    ("primitives", "node", "message"),
    [
        (QUADS.replace("6 7", "6 8"), "", r"maxindex=8.* beyond the limits"),
        (QUADS.replace("6 7", "6 x"), "", r"cannot be read"),
        (QUADS.replace("4 4<", "4 5<"), "", r"not as many corners|cannot be read"),
        (QUADS, "<translate>nan 0 0</translate>", r"transform of geometry g is not finite"),
        (QUADS.replace("#v", "#w"), "", r"cannot be read"),
        ("<polygons>" + INPUT + "<ph><p>0 1 9</p></ph></polygons>", "", r"uses vertex 9"),
        ("<open>", "", r"cannot be read"),
    ],
)
def test_what_is_wrong_with_a_dae_is_named(tmp_path: Path, primitives: str, node: str, message: str):
    with pytest.raises(InputError, match=rf"a\.dae'.*({message})"):
        dae(tmp_path, PLATES, primitives, node=node)
