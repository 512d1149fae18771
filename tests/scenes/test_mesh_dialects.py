"""OBJ, PLY, OFF and STL as people write them: the same two plates from each, and what is wrong refused with its line."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from tests.scenes.mesh_cases import CASES, assert_same, read, written
from wkernels.errors import InputError

PLATES = [
    *([-1.5, 1, -0.5], [-1.5, 1, 0.5], [-0.5, 1, 0.5], [-0.5, 1, -0.5]),
    *([0.6, 2, -0.4], [0.6, 2, 0.4], [1.4, 2, 0.4], [1.4, 2, -0.4]),
]
FACES = [[0, 1, 2, 3], [4, 5, 6, 7]]
TRIANGLES = np.array(PLATES), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
V = "".join(f"v {x} {y} {z}\n" for x, y, z in PLATES)
F = "f 1 2 3 4\nf 5 6 7 8\n"


@pytest.mark.parametrize("path", sorted((CASES / "obj").iterdir()), ids=lambda path: path.name)
def test_cases_of_obj(path: Path):
    assert_same(read(path), TRIANGLES)


@pytest.mark.parametrize("name", ["latin_comment.obj", "p_mixed.ply"])
def test_cases_of_files(name: str):
    assert_same(read(CASES / name), TRIANGLES)


OBJ = {
    "carriage returns alone": (V + F).replace("\n", "\r"),
    "UTF-16": (V + F).encode("utf-16"),
    "UTF-8 mark and Latin-1": b"\xef\xbb\xbf# Gr\xfc\xdfe\x85\n" + (V + F).encode(),
    "NEL in a Latin-1 name": b"o stra\x85e\n" + (V + F).encode(),
    "continued lines": V + "f 1 2 \\\n3 4\nf 5 \\\r\n 6 7\\\n 8\n",
    "continued and commented": V + "f 1 2 3 4 # a \\\nf 5 6 7 8",
    "blanks before and behind": "\n\n" + (V + F).replace("\n", "  \t\n").replace("f", " \tf").replace("v", "  v"),
    "texture coordinates": V + "vt 0 0\nvt 1 1\n" + "f 1/1 2/2 3/1 4/2\nf 5/1 6/2 7/1 8/2",
    "normals": V + "vn 0 1 0\n" + "f 1//1 2//1 3//1 4//1\nf 5//1 6//1 7//1 8//1",
    "both": V + "vt 0 0\nvn 0 1 0\n" + "f 1/1/1 2/1/1 3/1/1 4/1/1\nf 5/1/1 6/1/1 7/1/1 8/1/1",
    "all relative": V + "vt 0 0\nvn 0 1 0\n" + "f -8/-1/-1 -7/-1/-1 -6/-1/-1 -5/-1/-1\nf -4//-1 -3//-1 -2//-1 -1//-1",
    "mixed signs": V + "f 1 -7 3 -5\nf -4 6 -2 8",
    "normals that are not there": V + "f 1//9 2//9 3//9 4//9\nf 5/3 6/3 7/3 8/3",
    "colours of vertices": V.replace("\n", " 0.5 0.5 1\n") + F,
    "weights": V.replace("\n", " 1.0\n") + F,
    "vertices behind the faces": F + V,
    "groups and materials": "mtllib ü ü.mtl\no a b\ng\ns off\nusemtl x\n" + V + "g a b c\ns 1\n" + F + "usemtl\n",
    "the old name of a face": V + F.replace("f", "fo"),
    "exponents and signs": V.replace("-1.5", "-15e-1").replace(" 0.5", " +.5E0") + F,
}


@pytest.mark.parametrize("text", OBJ.values(), ids=list(OBJ))
def test_dialects_of_obj(tmp_path: Path, text: str | bytes):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing is lost, so nothing is told
        assert_same(read(written(tmp_path, "a.obj", text)), TRIANGLES)


BAD_OBJ = {
    "f 1 2 9": r"line 9: a face uses vertex 9, but they run from 1 to 8",
    "f 1 2 0": r"line 9: a face uses vertex 0, but they count from 1",
    "f -9 1 2": r"line 9: a face uses vertex -9, but there are only 8 before it",
    "f 1 2 3\n\nf 1 \\\n2 33": r"line 11: a face uses vertex 33",
    "f a b c": r"line 9: 'a' is not a whole number",
    "f 1.5 2 3": r"line 9: '1.5' is not a whole number",
    "f 99999999999999999999 1 2": r"line 9: '9{20}' is too large a number",
    "v 1 2": r"line 9: a vertex needs three coordinates",
    "v 1,5 0 0": r"line 9: '1,5 0 0' is no vertex",
    "": r"has no triangles",
    "v 0 0 1e300\nf 9 2 3": r"has a coordinate of 1e\+300; lengths beyond 1e\+12",
    "v 0 0 -2e12\nf 9 2 3": r"has a coordinate of 2e\+12",
}


@pytest.mark.parametrize("text", BAD_OBJ, ids=[str(i) for i in range(len(BAD_OBJ))])
def test_what_is_wrong_with_an_obj_names_file_and_line(tmp_path: Path, text: str):
    with pytest.raises(InputError, match=r"a\.obj'.*" + BAD_OBJ[text]):
        read(written(tmp_path, "a.obj", V + text + "\n"))


def test_what_an_obj_loses_is_told(tmp_path: Path):
    text = V + F + "l 1 2 3\np 1\np 2\nf 1 2\nsurf 0 1 0 1 1 2\nhair 3\n"
    with pytest.warns(
        UserWarning, match=r"left out: 1 lines, 2 points, 1 faces of fewer than three corners, 1 state.*'hair'"
    ):
        assert_same(read(written(tmp_path, "a.obj", text)), TRIANGLES)


def test_a_coordinate_at_the_limit_is_read(tmp_path: Path):
    vertices, _ = read(written(tmp_path, "a.obj", "v 0 0 1e12\nv 1 0 0\nv 0 1 0\nf 1 2 3\nv 9e99 0 0\n"))
    assert vertices.max() == 1e12  # and what no face uses does not count


def ply(form: str, header: str, body: bytes, newline: str = "\n") -> bytes:
    head = f"ply\nformat {form} 1.0\ncomment Gr\xfc\xdfe\n{header}end_header\n"
    return head.replace("\n", newline).encode("latin-1") + body


XYZ = "element vertex 8\nproperty float x\nproperty float y\nproperty float z\n"


def binary_ply(
    order: str, count: str, index: str, faces: list[list[int]], extra: str = "", newline: str = "\n"
) -> bytes:
    names = {
        "B": "uchar",
        "b": "int8",
        "H": "ushort",
        "h": "int16",
        "i": "int",
        "I": "uint32",
        "f": "float",
        "d": "double",
    }
    extras = {"": "", "before": "property float quality\n", "behind": "property list uchar float texcoord\n"}
    header = XYZ + f"element face {len(faces)}\n"
    header += extras[extra] if extra == "before" else ""
    header += f"property list {names[count]} {names[index]} vertex_indices\n"
    header += extras[extra] if extra == "behind" else ""
    body = b"".join(struct.pack(order + "3f", *vertex) for vertex in PLATES)
    for i, face in enumerate(faces):
        body += struct.pack(order + "f", 0.5) if extra == "before" else b""
        body += struct.pack(order + count, len(face)) + struct.pack(f"{order}{len(face)}{index}", *face)
        body += struct.pack(f"{order}B{i}f", i, *[0.5] * i) if extra == "behind" else b""
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    return ply(form, header, body, newline)


MIXED = [[0, 1, 2], [0, 2, 3], [4, 5, 6, 7]]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("count", "index"), [("B", "i"), ("b", "I"), ("H", "h"), ("i", "B"), ("I", "H"), ("B", "f"), ("h", "d")]
)
@pytest.mark.parametrize("faces", [FACES, MIXED], ids=["quads", "mixed"])
def test_binary_ply(tmp_path: Path, order: str, count: str, index: str, faces: list[list[int]]):
    assert_same(read(written(tmp_path, "a.ply", binary_ply(order, count, index, faces))), TRIANGLES)


@pytest.mark.parametrize("extra", ["before", "behind"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_binary_ply_with_other_properties_and_ends_of_lines(tmp_path: Path, extra: str, newline: str):
    assert_same(read(written(tmp_path, "a.ply", binary_ply("<", "B", "i", MIXED, extra, newline))), TRIANGLES)


ASCII = "".join(f"{x} {y} {z} 7\n" for x, y, z in PLATES) + "4 0 1 2 3 9\n4 4 5 6 7 9\n"
ASCII_HEADER = XYZ + "property uchar red\nelement face 2\nproperty list uchar int vertex_index\nproperty int flags\n"


@pytest.mark.parametrize(
    "body", [ASCII, ASCII.replace(" ", "\t"), ASCII.replace("\n", "\r\n"), ASCII.replace("\n", " "), "\n" + ASCII]
)
def test_text_ply(tmp_path: Path, body: str):
    assert_same(read(written(tmp_path, "a.ply", ply("ascii", ASCII_HEADER, body.encode()))), TRIANGLES)


def test_ply_elements_in_another_order_and_strange_ones(tmp_path: Path):
    header = "element face 2\nproperty list uchar int vertex_index\nelement odd 2\nproperty list int float data\n" + XYZ
    body = "4 0 1 2 3\n4 4 5 6 7\n2 0.5 0.5\n0\n" + "".join(f"{x} {y} {z}\n" for x, y, z in PLATES)
    assert_same(read(written(tmp_path, "a.ply", ply("ascii", header, body.encode()))), TRIANGLES)


def test_ply_strips(tmp_path: Path):
    header = XYZ + "element tristrips 1\nproperty list int int vertex_indices\n"
    body = "".join(f"{x} {y} {z}\n" for x, y, z in PLATES) + "9 0 1 3 2 -1 4 5 7 6\n"
    vertices, faces = TRIANGLES[0], np.array([[0, 1, 3], [1, 2, 3], [4, 5, 7], [5, 6, 7]])
    assert_same(read(written(tmp_path, "a.ply", ply("ascii", header, body.encode()))), (vertices, faces))


BAD_PLY = {
    "index": (binary_ply("<", "B", "i", [[0, 1, 8]]), r"a face uses vertex 8, but they run from 0 to 7"),
    "negative index": (binary_ply("<", "B", "i", [[0, 1, -1]]), r"a face uses vertex -1"),
    "text index": (
        ply("ascii", ASCII_HEADER, ASCII.replace("6 7 9", "6 8 9").encode()),
        r"line 22: a face uses vertex 8",
    ),
    "broken index": (ply("ascii", ASCII_HEADER, ASCII.replace("6 7 9", "6 .5 9").encode()), r"not whole"),
    "word": (ply("ascii", ASCII_HEADER, ASCII.replace("6 7 9", "6 x 9").encode()), r"line 22: 'x' is not a number"),
    "negative length": (ply("ascii", ASCII_HEADER, ASCII.replace("4 4", "-4 4").encode()), r"a list has the length -4"),
    "short": (binary_ply("<", "B", "i", MIXED)[:-1], r"ends within its elements face"),
    "short vertices": (binary_ply("<", "B", "i", MIXED)[:200], r"ends within its elements vertex, of which 8"),
    "short text": (ply("ascii", ASCII_HEADER, ASCII[:-8].encode()), r"ends within its elements face, of which 2"),
    "endless": (ply("ascii", XYZ.replace("8", "99999999999"), b"0 0 0\n"), r"ends within its elements vertex"),
    "cloud": (ply("ascii", XYZ, ASCII.replace(" 7\n", "\n").encode()), r"a cloud of points"),
    "type": (ply("ascii", XYZ.replace("float", "half"), b""), r"line 5: 'half' is no type"),
    "format": (ply("binary", XYZ, b""), r"line 2: 'binary 1.0' is no format"),
    "no end": (b"ply\nformat ascii 1.0\nelement vertex 3\n", r"has no end_header"),
    "flat": (ply("ascii", "element vertex 1\nproperty float x\nproperty float y\n", b"0 0\n"), r"lack x, y or z"),
    "other": (b"solid a\n", r"begins with 'solid"),
}


@pytest.mark.parametrize("case", BAD_PLY)
def test_what_is_wrong_with_a_ply_is_named(tmp_path: Path, case: str):
    data, message = BAD_PLY[case]
    with pytest.raises(InputError, match=r"a\.ply'.*" + message):
        read(written(tmp_path, "a.ply", data))


OFF_BODY = "".join(f"{x} {y} {z}\n" for x, y, z in PLATES) + "4 0 1 2 3\n4 4 5 6 7\n"
OFF = {
    "plain": "OFF\n8 2 0\n" + OFF_BODY,
    "sizes beside the word": "OFF 8 2 0\n" + OFF_BODY,
    "no word": "8 2 0\n" + OFF_BODY,
    "no edges": "OFF\n8 2\n" + OFF_BODY,
    "comments": "# a\nOFF # b\n\n8 2 0 # c\n" + OFF_BODY.replace("\n", " # d\n\n"),
    "colours of faces": "OFF\n8 2 0\n" + OFF_BODY.replace("2 3\n", "2 3 0.5 0.5 1\n").replace("6 7\n", "6 7 255\n"),
    "normals": "NOFF\n8 2 0\n" + OFF_BODY.replace("\n", " 0 1 0\n", 8),
    "colours": "COFF\n8 2 0\n" + OFF_BODY.replace("\n", " 255 255 0 255\n", 8),
    "all of them": "STCNOFF\n8 2 0\n" + OFF_BODY.replace("\n", " 0 1 0 1 1 1 1 0 0\n", 8),
    "Latin-1 and CRLF": b"\xef\xbb\xbfOFF # \xfc\r\n" + ("8 2 0\n" + OFF_BODY).replace("\n", "\r\n").encode(),
    "weights": "4OFF\n8 2 0\n" + "".join(f"{2 * x} {2 * y} {2 * z} 2\n" for x, y, z in PLATES) + OFF_BODY[-20:],
}


@pytest.mark.parametrize("text", OFF.values(), ids=list(OFF))
def test_dialects_of_off(tmp_path: Path, text: str | bytes):
    assert_same(read(written(tmp_path, "a.off", text)), TRIANGLES)


BAD_OFF = {
    "OFF\n8 2 0\n" + OFF_BODY.replace("6 7", "6 8"): r"line 12: a face uses vertex 8, but they run from 0 to 7",
    "OFF\n8 3 0\n" + OFF_BODY: r"8 vertices and 3 faces are announced, but 10 lines follow",
    "OFF\n8 2 0\n" + OFF_BODY.replace("4 4", "5 4"): r"line 12: a face of 5 corners has 4 numbers",
    "OFF BINARY\n": r"is binary OFF",
    "nOFF 4\n": r"any number of dimensions",
    "ply\n": r"begins with 'ply', not with OFF",
    "": r"is empty",
}


@pytest.mark.parametrize("text", BAD_OFF, ids=[str(i) for i in range(len(BAD_OFF))])
def test_what_is_wrong_with_an_off_is_named(tmp_path: Path, text: str):
    with pytest.raises(InputError, match=r"a\.off'.*" + BAD_OFF[text]):
        read(written(tmp_path, "a.off", text))


def stl_text(name: str = "a") -> str:
    out = f"solid {name}\n"
    for face in TRIANGLES[1]:
        rows = "".join("   vertex {} {} {}\n".format(*PLATES[i]) for i in face)
        out += f"facet normal 0 1 0\n outer loop\n{rows} endloop\nendfacet\n"
    return out + f"endsolid {name}\n"


def stl_binary(header: bytes = b"", behind: bytes = b"") -> bytes:
    out = header.ljust(80, b" ") + struct.pack("<I", len(TRIANGLES[1]))
    for face in TRIANGLES[1]:
        out += struct.pack("<12fH", 0, 1, 0, *(x for i in face for x in PLATES[i]), 0)
    return out + behind


STL = {
    "text": stl_text(),
    "capitals": stl_text().upper(),
    "no name": stl_text("").replace("endsolid ", "endsolid"),
    "a Latin-1 name": stl_text("facet loop vertex \xfc").encode("latin-1"),
    "one line": stl_text().replace("\n", " ", 40).replace("solid a ", "solid a\n", 1),
    "CRLF and tabs": stl_text().replace("\n", "\r\n").replace("   ", "\t"),
    "no endsolid": stl_text().removesuffix("endsolid a\n"),
    "two solids": stl_text().replace("endfacet\n", "endfacet\nendsolid a\nsolid b\n", 2),
    "UTF-8 mark": b"\xef\xbb\xbf" + stl_text().encode(),
    "binary": stl_binary(),
    "binary that begins as text": stl_binary(b"solid exported"),
}


@pytest.mark.parametrize("data", STL.values(), ids=list(STL))
def test_dialects_of_stl(tmp_path: Path, data: str | bytes):
    assert_same(read(written(tmp_path, "a.stl", data)), TRIANGLES)


def test_bytes_behind_a_binary_stl_are_told(tmp_path: Path):
    with pytest.warns(UserWarning, match=r"left out: 7 bytes"):
        assert_same(read(written(tmp_path, "a.stl", stl_binary(behind=b"1234567"))), TRIANGLES)


BAD_STL = {
    "short": (stl_binary()[:-1], r"announces 4 facets and holds 3"),
    "word": (stl_text().replace("0.6", "x", 1), r"line 18: 'x' is not a number"),
    "corner": (stl_text().replace("   vertex -1.5 1 -0.5\n", "", 1), r"line 6: a facet has 2 corners"),
    "end": (stl_text().partition(" endloop")[0], r"line 6: ends within a facet"),
    "other": (b"\0" * 20, r"neither text nor whole"),
}


@pytest.mark.parametrize("case", BAD_STL)
def test_what_is_wrong_with_an_stl_is_named(tmp_path: Path, case: str):
    data, message = BAD_STL[case]
    with pytest.raises(InputError, match=r"a\.stl'.*" + message):
        read(written(tmp_path, "a.stl", data))
