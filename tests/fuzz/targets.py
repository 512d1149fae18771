"""All kinds of inputs by name, and how many of each a long run has."""

from __future__ import annotations

from collections.abc import Mapping

from experiment_files import FEW, BrokenExperiments, MadeWrong, RightExperiments
from mesh_files import ImportedFiles, MeshFiles
from result_folders import ResultFolders
from trying import Target

SHARES = {"mesh": 30.0, "import": 20.0, "broken": 20.0, "config": 20.0, "experiment": 8.0, "results": 2.0}


def targets() -> Mapping[str, Target]:
    """The targets by name."""
    made: list[Target] = [
        MeshFiles(),
        ImportedFiles(),
        RightExperiments(),
        BrokenExperiments(),
        MadeWrong(),
        ResultFolders(),
    ]
    return {target.name: target for target in made}


def few() -> Mapping[str, Target]:
    """The same, with experiments of few techniques: what tests have time for."""
    return {**targets(), "experiment": RightExperiments(FEW)}
