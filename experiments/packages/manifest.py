"""Which files real scenes are made of, and the package that each comes in (manifest.yaml)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from experiments.config.source import StrictModel, load_yaml, validate

MANIFEST = Path(__file__).with_name("manifest.yaml")


class Asset(StrictModel):
    """A folder of files from one package.

    Attributes:
        name: Of the folder; ``fetched:NAME/FILE`` in scene files.
        tool: The package tool that has it.
        package: Its name there.
        version: Which; None where the tool decides (the digest says whether it was the right one).
        inside: A zip archive within the package that holds the files; None: the package itself does.
        take: Path in the package to path in the folder. A path that ends in ``/`` is all that lies below it; files
            that end in .gz are unpacked, and lose that ending.
        sha256: Digest of the folder's listing (``unpacking.listing_digest``).
        licence: Of the files, as far as the package says.
    """

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    tool: Literal["pip", "npm", "apt", "cargo"]
    package: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]*$")]
    version: Annotated[str, Field(pattern=r"^[0-9][A-Za-z0-9._-]*$")] | None = None
    inside: str | None = None
    take: Annotated[dict[str, str], Field(min_length=1)]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    licence: Annotated[str, Field(min_length=1)]

    @property
    def source(self) -> tuple[str, str, str | None]:
        """What is downloaded once for all assets that share it: tool, package, version."""
        return self.tool, self.package, self.version

    @property
    def origin(self) -> str:
        """The same for people."""
        return f"{self.tool}: {self.package}{f' {self.version}' if self.version else ''}"


class Manifest(StrictModel):
    """The file's top level.

    Attributes:
        assets: All there are.
    """

    assets: list[Asset]


def read_manifest(path: Path = MANIFEST) -> list[Asset]:
    """The assets of a manifest; raises InputError."""
    return validate(Manifest, load_yaml(path)).assets
