"""Mesh files as casters over a plane: the share of the plane that is lit; what is told reaches people, once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments import render_visibility
from tests.scenes.mesh_cases import CASES

PLATES = ["obj/neg_interleaved.obj", "obj/tabs.obj", "p_mixed.ply", "gltf/quant_i16norm.glb", "gltf/ext space.gltf"]


def lit(name: str, size: float, direction: list[float], camera: dict) -> np.ndarray:
    scene = {
        "meshes": [{"primitive": "plane", "size": [size, size]}, {"file": str(CASES / name)}],
        "lights": [{"kind": "directional", "direction": direction}],
        "camera": {**camera, "fov_deg": 45},
    }
    return render_visibility(scene, technique="ray_cast_point_shadow", width=320, height=180).visibility


def door(name: str) -> np.ndarray:
    return lit(name, 12, [0, -1, 1], {"eye": [0, 5, 9], "target": [0, 0.5, 1]})


def plates(name: str) -> np.ndarray:
    return lit(name, 8, [0, -1, 0], {"eye": [0, 6, 6], "target": [0, 0.5, 0]})


def test_light_comes_through_the_door() -> None:
    truth = door("polygons/truth.obj")
    assert np.nanmean(truth) == pytest.approx(0.7822, abs=0.002)
    assert np.mean(np.nan_to_num(door("polygons/door.obj"), nan=-1) != np.nan_to_num(truth, nan=-1)) < 0.002


@pytest.mark.parametrize("name", PLATES)
def test_two_plates_cast_two_shadows(name: str) -> None:
    picture = plates(name)
    assert np.nanmean(picture) == pytest.approx(0.9736, abs=0.002)
    assert np.mean(np.nan_to_num(picture, nan=-1) != np.nan_to_num(plates("obj/plain.obj"), nan=-1)) < 0.002


def test_what_a_mesh_file_loses_is_told_once_and_an_error_ends_with_status_2(tmp_path: Path) -> None:
    head = "lights: [{kind: point, position: [0, 9, 0]}]\ncamera: {eye: [0, 0, 5], target: [0, 0, 0]}\nmeshes:\n"
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nl 1 2\n")
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n")
    (tmp_path / "scene.yaml").write_text(head + "- {file: a.obj}\n- {file: a.obj}\n")
    (tmp_path / "e.yaml").write_text(
        "kind: walkthrough\nscene: scene.yaml\nimage: {width: 16, height: 9}\ntechniques: [shadow_map]\n"
    )

    def explain() -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "experiments.cli", "explain", str(tmp_path / "e.yaml")]
        return subprocess.run(command, capture_output=True, text=True)

    done = explain()
    assert done.returncode == 0
    told = f"warning: {tmp_path}/scene.yaml:4: meshes.0.file: '{tmp_path}/a.obj': left out: 1 lines.\n"
    assert done.stderr == told
    (tmp_path / "scene.yaml").write_text(head + "- {file: b.obj}\n")
    done = explain()
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and "line 4: a face uses vertex 4, but they run from 1 to 3" in done.stderr
