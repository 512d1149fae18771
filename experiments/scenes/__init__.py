"""Scene files (YAML or the same keys as a dict) to ``wkernels.scene.model.Scene``: meshes, lights, camera paths."""

from experiments.scenes.loader import load_scene, scene_from_source

__all__ = ["load_scene", "scene_from_source"]
