"""The experiment file of ``kind: stability``: techniques and cases, all unless listed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from experiments.config.overrides import apply_overrides
from experiments.config.source import Source, StrictModel, dump_yaml, load_yaml, validate
from experiments.kinds.stability.cases import CASES
from wkernels.errors import nearest


class StabilityFile(StrictModel):
    """An experiment file of ``kind: stability``.

    Attributes:
        techniques: Names; all unless listed.
        cases: Names of cases; all unless listed.
    """

    kind: Literal["stability"]
    techniques: list[str] | None = None
    cases: list[str] | None = None


@dataclass(frozen=True, eq=False)
class Stability:
    """A resolved stability experiment.

    Attributes:
        name: Stem of the experiment file.
        techniques: Names, in file order.
        cases: Keys of ``experiments.kinds.stability.cases.CASES``, in file order.
    """

    name: str
    techniques: tuple[str, ...]
    cases: tuple[str, ...]

    def to_yaml(self) -> str:
        """The experiment as a file that runs again and gives the same results."""
        return dump_yaml({"kind": "stability", "techniques": list(self.techniques), "cases": list(self.cases)})


def load_stability(path: str | Path, overrides: Iterable[str], plugins: Mapping[str, type]) -> Stability:
    """Reads, checks and resolves a stability experiment.

    Raises:
        InputError: Something in the file or the overrides is wrong.
    """
    source = apply_overrides(load_yaml(Path(path)), overrides)
    file = validate(StabilityFile, source)
    return Stability(
        Path(path).stem,
        _names(source, "techniques", "technique", file.techniques, plugins),
        _names(source, "cases", "case", file.cases, CASES),
    )


def _names(
    source: Source, key: str, what: str, names: list[str] | None, known: Mapping[str, object]
) -> tuple[str, ...]:
    if names is None:
        return tuple(known)
    if not names:
        raise source.error(f"must name at least one {what}.", (key,))
    for i, name in enumerate(names):
        if name not in known:
            raise source.error(f"there is no {what} '{name}'." + nearest(name, known), (key, i))
        if name in names[:i]:
            raise source.error(f"the {what} '{name}' is listed twice.", (key, i))
    return tuple(names)
