"""The experiment file of ``kind: walkthrough``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from algorithms.plugins import load_all
from experiments.config.source import validate
from experiments.kinds.kind import check_kind
from experiments.schema.experiment import Experiment, open_scene, read_experiment, resolve
from experiments.schema.models import RunFile
from experiments.schema.needs import check_runs
from experiments.schema.techniques import expand_techniques
from wkernels.errors import nearest


class WalkthroughFile(RunFile):
    """An experiment file of this kind; ``RunFile`` and ``Experiment`` say what the other keys mean.

    Attributes:
        scene: A scene file, relative to this one, or its keys.
        techniques: What is compared; entries as below.
    """

    kind: Literal["walkthrough"]
    scene: str | dict[str, Any]
    techniques: list[str | dict[str, Any]] = Field(min_length=1)


def load_experiment(
    path: str | Path, overrides: Iterable[str] = (), plugins: Mapping[str, type] | None = None
) -> Experiment:
    """Reads, checks and resolves an experiment file together with its scene.

    Args:
        path: The YAML file.
        overrides: ``key.path=value`` texts, as given to ``--set``.
        plugins: Techniques by name; None finds those of the installed packages.

    Raises:
        InputError: Something in the file, the overrides or the scene is wrong, or a technique cannot use the light.
    """
    path, plugins = Path(path), load_all() if plugins is None else plugins
    source = read_experiment(path, overrides)
    check_kind(source)
    file = validate(WalkthroughFile, source)
    runs = expand_techniques(source, plugins, file.projection)
    labels = [run.label for run in runs]
    if file.baseline is not None and file.baseline not in labels:
        message = f"no technique has the label '{file.baseline}'." + nearest(file.baseline, labels)
        raise source.error(message, ("baseline",))
    opened = open_scene(source, path.resolve().parent, file.light)
    check_runs(runs, plugins, opened[1], file.light, source)
    return resolve(path.stem, source, file, runs, file.baseline or labels[0], opened, labels)
