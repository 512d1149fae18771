"""What a kind of experiment is, and which there are: every folder here with a ``kind.py``."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from algorithms.modules import defined_in
from experiments import kinds
from experiments.config.overrides import apply_overrides
from experiments.config.source import Source, StrictModel, load_yaml
from experiments.results.store import Store
from wkernels.errors import InputError, nearest

if TYPE_CHECKING:
    from experiments.results.compare import Compared

PLAIN = "walkthrough"
"""What a result folder is whose record names no kind, and whose loader says what is wrong with a file of none."""
PLANNED = ("bench",)


class Progress(Protocol):
    """Is told what happens; ``done`` of ``total`` pieces of work are stored."""

    def __call__(self, done: int, total: int, what: str) -> None:
        """Called before each piece of work that takes time, and at the end."""


class Kind(ABC):
    """A kind of experiment; subclasses are final and stand alone in the ``kind.py`` of a folder of that name.

    Attributes:
        name: Folder = value of the key ``kind`` = that of ``run.kind`` in environment.json.
        schemas: Models of its experiment file; any of them will do.
        techniques: Whether it renders techniques, so that they have to be found.
    """

    name: ClassVar[str]
    schemas: ClassVar[tuple[type[StrictModel], ...]]
    techniques: ClassVar[bool] = True

    @abstractmethod
    def load(self, path: Path, overrides: Sequence[str], plugins: Mapping[str, Any]) -> Any:
        """An experiment file, checked and resolved; has the attribute ``name``.

        Args:
            path: The file.
            overrides: ``key.path=value`` texts, as given to ``--set``.
            plugins: Technique classes by name.

        Raises:
            InputError: Something in the file, the overrides or its scenes is wrong.
        """

    @abstractmethod
    def run(self, experiment: Any, out: Path, plugins: Mapping[str, Any], progress: Progress, **options: Any) -> str:
        """Runs what ``load`` gave, and writes its result folder and report.

        Args:
            experiment: What to run.
            out: Result folder.
            plugins: Technique classes by name.
            progress: Is told what happens.
            **options: ``device``, ``threads``, ``resume`` and ``skips``, as on the command line.

        Returns:
            What to print in the end.
        """

    @abstractmethod
    def explain(self, experiment: Any, plugins: Mapping[str, Any]) -> str:
        """What ``run`` will do, for people; renders nothing."""

    def tables(self) -> Mapping[str, Sequence[str]]:
        """Columns of the tables that its result folders hold, by file name; of those of another kind only its own."""
        return {}

    def write_report(self, out: Path) -> Path:
        """Writes the report of a result folder again, from its files alone, and returns its path."""
        raise InputError(f"is of the kind {self.name}, which has no report.", file=out)

    def recompute(self, out: Path) -> int:
        """Computes the metrics of a folder again from its images; how many rows."""
        raise InputError(f"is of the kind {self.name}, whose rows cannot be computed again.", file=out)

    def compare(self, a: Path, b: Path) -> Compared:
        """How one result folder differs from another; InputError where they cannot be compared."""
        from experiments.results.compare import compare

        return compare(a, b)


def names() -> list[str]:
    """Names of the kinds, sorted."""
    return sorted(path.parent.name for folder in kinds.__path__ for path in Path(folder).glob("*/kind.py"))


def find(name: str) -> Kind:
    """A kind by name; loads no other."""
    module = importlib.import_module(f"experiments.kinds.{name}.kind")
    (kind,) = defined_in(module, Kind)
    found: Kind = kind()
    return found


def kind_of_file(path: str | Path, overrides: Iterable[str] = ()) -> Kind:
    """The kind of an experiment file, before anything else in it is looked at.

    ``PLAIN`` where it names none, or cannot be read: the loader says so better.
    """
    own = [text for text in overrides if text.partition("=")[0].strip() == "kind"]
    try:
        source = load_yaml(Path(path))
        name = apply_overrides(source, own).data.get("kind") if isinstance(source.data, Mapping) else None
    except InputError:
        name = None
    return find(name if name in names() else PLAIN)


def kind_of_folder(out: Path) -> Kind:
    """The kind of a result folder, complete or not, as its environment.json says; InputError where that is broken."""
    record = Store(out).environment() if (out / "environment.json").is_file() else {}
    name = record.get("run", {}).get("kind")
    return find(name if name in names() else PLAIN)


def check_kind(source: Source) -> None:
    """Refuses a ``kind`` that there is not; InputError names the nearest."""
    kind = source.data.get("kind")
    if kind in PLANNED:
        message = f"kind '{kind}' is not available yet; available: {', '.join(names())}."
        raise source.error(message, ("kind",))
    if isinstance(kind, str) and kind not in names():
        raise source.error(f"'{kind}' is not a kind of experiment." + nearest(kind, (*names(), *PLANNED)), ("kind",))
