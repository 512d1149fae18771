"""``make fuzz``: many wrong inputs at everything that reads files. Ends with 1 where one of them did harm.

A fault is kept as a folder with its input and a note; ``--again FOLDER`` tries it once more, in this process.
"""

from __future__ import annotations

import argparse
import os
import secrets
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).parent)]

import pool  # noqa: E402
from targets import SHARES, targets  # noqa: E402


def main() -> int:
    """Runs, tells, and gives the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100_000, help="inputs; default: 100000")
    parser.add_argument("--seed", type=int, default=None, help="of the first batches; default: by chance, and told")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes; default: all cores")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "fuzz", help="folder for faults; default: out/fuzz")
    parser.add_argument("--target", action="append", choices=sorted(SHARES), help="only this one; repeatable")
    parser.add_argument("--again", type=Path, metavar="FOLDER", help="try a kept fault again, and nothing else")
    asked = parser.parse_args()
    if asked.again is not None:
        return _again(asked.again.resolve(), asked.out.resolve())
    return _fuzz(asked)


def _fuzz(asked: argparse.Namespace) -> int:
    out = asked.out.resolve()
    for old in [*out.glob("worker-*"), out / "faults"]:
        shutil.rmtree(old, ignore_errors=True)
    seed = secrets.randbelow(1 << 30) if asked.seed is None else asked.seed
    shares = {name: share for name, share in SHARES.items() if not asked.target or name in asked.target}
    print(f"{asked.count} inputs of {', '.join(shares)}; --seed {seed} repeats them", flush=True)
    tally = pool.run(
        targets,
        pool.jobs(shares, asked.count, seed),
        out,
        workers=asked.workers,
        caches=caches_below(out),
        tell=lambda tally: _tell(tally, asked.count),
    )
    print(_progress(tally, asked.count))
    for name, outcomes in tally.outcomes.items():
        print(f"  {name}: " + ", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common()))
    for (target, kind, where), found in sorted(tally.kinds().items()):
        print(f"FAULT {target}: {kind}, {where} ({len(found)} times; {found[0].folder})")
    for worker in out.glob("worker-*"):
        shutil.rmtree(worker, ignore_errors=True)
    return 1 if tally.findings else 0


def caches_below(out: Path) -> dict[str, Path]:
    """Caches that inputs may write, by variable: kernels are kept where they always are, all else below ``out``."""
    import platformdirs
    import warp as wp

    kernels = Path(os.environ.get("WARP_CACHE_PATH") or platformdirs.user_cache_path("warp") / wp.config.version)
    caches = {"WARP_CACHE_PATH": kernels, "WKERNELS_CACHE": out / "cache", "MPLCONFIGDIR": out / "matplotlib"}
    for path in caches.values():
        path.mkdir(parents=True, exist_ok=True)
    return caches


def _progress(tally: pool.Tally, count: int) -> str:
    kinds = len(tally.kinds())
    return f"{tally.count} of {count} in {tally.seconds:.0f} s, {len(tally.findings)} faults of {kinds} kinds"


def _tell(tally: pool.Tally, count: int) -> None:
    """A line that stays in its place on a terminal; elsewhere one a minute."""
    if sys.stdout.isatty():
        print(_progress(tally, count), end="\r", flush=True)
    elif int(tally.seconds) % 60 < pool.TOLD_EVERY:
        print(_progress(tally, count), flush=True)


def _again(folder: Path, out: Path) -> int:
    """Tries one kept input; its traceback is shown."""
    rooms = out / "again"
    shutil.rmtree(rooms, ignore_errors=True)
    shutil.copytree(folder / "input", rooms / "input")
    (rooms / "out").mkdir()
    os.environ |= {name: str(path) for name, path in caches_below(out).items()}
    print(targets()[folder.name.partition("-")[0]].check(rooms / "input", rooms / "out"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
