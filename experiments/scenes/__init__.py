"""Scene files (YAML or the same keys as a dict) to ``wkernels.scene.model.Scene``: meshes, lights, camera paths.

Begin with ``loader``; ``schema`` says what a file may say. ``generators`` make scenes from parameters, a file each,
found by scanning; ``analytic`` has the closed forms that the reference is held to.
"""

from experiments.scenes.loader import load_scene, scene_from_source

__all__ = ["load_scene", "scene_from_source"]
