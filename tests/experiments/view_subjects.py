"""Small scenes to be pictured, and what the pictures are made from."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments.kinds.walkthrough.config import load_experiment
from experiments.rendering.engine import WarpEngine
from experiments.views.subject import Subject

HEAD = """
kind: walkthrough
image: {width: 60, height: 40}
projection: {fit: focused, splits: 3, warp: lispsm_nopt}
techniques:
  - shadow_map: {resolution: 128}
frames: 1
views: {image: {width: 90, height: 60}}
"""
BOX = """
scene:
  meshes:
    - {primitive: plane, size: [16, 16]}
    - {primitive: box, size: [1, 1.4, 1], transform: {translate: [0, 0.8, 0]}}
  lights: [{kind: directional, direction: [0.3, -1, -0.4], angle_deg: 2}]
  camera: {eye: [0, 2.5, 6], target: [0, 0.5, 0], up: [0, 1, 0], fov_deg: 50, near: 0.1, far: 60}
"""
# seen straight from above, a pixel of the floor is 0.125 wide; a map of 66 with a texel of margin has 64 texels for its 8
ABOVE = """
scene:
  meshes: [{primitive: plane, size: [8, 8]}]
  lights: [{kind: directional, direction: [0, -1, 0]}]
  camera: {eye: [0, 4, 0], target: [0, 0, 0], up: [0, 0, -1], fov_deg: 53.13010235415598, near: 0.1, far: 60}
"""
# what receives is larger than the frustum on all sides, so that the maps cover exactly the frustum
WIDE = """
scene:
  meshes:
    - {primitive: plane, size: [90, 90], transform: {translate: [0, -40, 0]}}
    - {primitive: box, size: [1, 1, 1], transform: {translate: [0, 40, 0]}}
  lights: [{kind: directional, direction: [0, -1, 0]}]
  camera: {eye: [0, 0, 0], target: [0, 0, -1], up: [0, 1, 0], fov_deg: 60, near: 1, far: 40}
"""


def write_configs(folder: Path) -> Path:
    """An experiment file per scene."""
    for name, scene in {"box": BOX, "above": ABOVE, "wide": WIDE}.items():
        (folder / f"{name}.yaml").write_text(HEAD + scene)
    return folder


def make(files: Path, name: str, *changes: str, reference: np.ndarray | None = None) -> Subject:
    experiment = load_experiment(files / f"{name}.yaml", changes)
    engine = WarpEngine(experiment)
    session, technique = engine.open(experiment.runs[0])
    session.begin(0)
    return Subject(
        experiment,
        engine,
        experiment.runs[0],
        session,
        session.render(technique),
        0,
        reference,  # type: ignore[arg-type]
    )
