"""The command line. Nothing heavy is imported here, so that ``wkernels --help`` answers at once.

Exit status: 0 done, 2 the input is wrong or an output cannot be written (one message), 1 a defect (traceback in a log
file) or a failure in a run (failures.csv says which; all else is there), 130 interrupted.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    name="wkernels",
    help="Shadow algorithms as NVIDIA Warp kernels: error against run time, by one set of rules.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Plugins = Annotated[
    list[Path] | None,
    typer.Option("--plugin", metavar="FILE.py", help="A technique or part of projections; repeatable."),
]
Device = Annotated[str, typer.Option(help="cpu, or a CUDA device such as cuda:0.")]
Threads = Annotated[int | None, typer.Option(min=1, max=1024, help="CPU threads; default: all.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY.PATH=VALUE", help="Change a key of CONFIG; repeatable.")
]
Config = Annotated[Path, typer.Argument(metavar="CONFIG", help="Experiment file (YAML).", show_default=False)]


@app.command("list")
def list_command(
    as_json: Annotated[bool, typer.Option("--json", help="Everything, parameters included, as JSON.")] = False,
    plugin: Plugins = None,
) -> None:
    """List the techniques with their family, paper and needs."""
    from experiments.commands.listing import list_techniques

    list_techniques(as_json=as_json, plugin_files=plugin or [])


@app.command()
def run(
    config: Config,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Result folder; default: out/NAME of CONFIG.")] = None,
    overrides: Overrides = None,
    device: Device = "cpu",
    threads: Threads = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue an interrupted run in the same folder.")] = False,
    no_skips: Annotated[bool, typer.Option("--no-skips", help="Do all work, even what cannot matter.")] = False,
    plugin: Plugins = None,
) -> None:
    """Run an experiment and write its results and report."""
    from experiments.commands.run import run_experiment

    run_experiment(
        config,
        out,
        overrides=overrides or [],
        device=device,
        threads=threads,
        resume=resume,
        skips=not no_skips,
        plugin_files=plugin or [],
    )


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder of a run.", show_default=False)],
    recompute: Annotated[
        bool, typer.Option("--recompute", help="Compute the metrics again from the raw images first.")
    ] = False,
) -> None:
    """Write the report of a result folder again, from its files alone."""
    from experiments.commands.run import report_folder

    report_folder(folder, recompute=recompute)


@app.command()
def explain(config: Config, overrides: Overrides = None, plugin: Plugins = None) -> None:
    """Say what CONFIG will run, what is left out and why; renders nothing."""
    from experiments.commands.run import explain_experiment

    explain_experiment(config, overrides=overrides or [], plugin_files=plugin or [])


@app.command()
def render(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (YAML).", show_default=False)],
    technique: Annotated[str, typer.Option(metavar="NAME", help="See 'wkernels list'.", show_default=False)],
    out: Annotated[Path | None, typer.Option(metavar="FILE", help=".exr or .png; default: NAME.exr.")] = None,
    width: Annotated[int, typer.Option(min=1, max=16384, help="Pixels.")] = 640,
    height: Annotated[int, typer.Option(min=1, max=16384, help="Pixels.")] = 360,
    frame: Annotated[int, typer.Option(min=0, help="Frame of the scene's path.")] = 0,
    frames: Annotated[int, typer.Option(min=1, help="Frames rendered up to that one, for temporal methods.")] = 1,
    param: Annotated[
        list[str] | None, typer.Option(metavar="KEY=VALUE", help="A parameter of the technique; repeatable.")
    ] = None,
    light: Annotated[int, typer.Option(min=0, help="Index of the light in the scene.")] = 0,
    samples: Annotated[int | None, typer.Option(min=1, help="Short for --param samples=N.")] = None,
    device: Device = "cpu",
    threads: Threads = None,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Seed of the sample sets.")] = 1,
    plugin: Plugins = None,
) -> None:
    """Render one visibility image: 1 = lit, 0 = umbra, NaN (slate in a PNG) where no receiver is seen."""
    from experiments.commands.render import render_image

    render_image(
        scene,
        technique,
        out or Path(f"{technique}.exr"),
        param_texts=[*(param or []), *([f"samples={samples}"] if samples else [])],
        plugin_files=plugin or [],
        width=width,
        height=height,
        frame=frame,
        frames=frames,
        light=light,
        device=device,
        threads=threads,
        seed=seed,
    )


@app.command()
def doctor() -> None:
    """Check this installation: packages, devices, cache, and a kernel on one and two threads."""
    from experiments.commands.doctor import examine

    if not examine():
        raise typer.Exit(1)


@app.command()
def bench(
    as_json: Annotated[bool, typer.Option("--json", help="Machine, versions and every row as JSON.")] = False,
    case: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A case, or the beginning of some, such as depth or scale_; repeatable."),
    ] = None,
    list_only: Annotated[bool, typer.Option("--list", help="Name the cases; time nothing.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Write plots of the scaling cases there.")] = None,
    threads: Threads = None,
    repeats: Annotated[int, typer.Option(min=1, max=1000, help="Timed runs of each side; medians are shown.")] = 9,
) -> None:
    """Time our passes beside other renderers', every technique's frame, scaling, start-up and memory."""
    from experiments.commands.bench import list_cases, run_bench

    if list_only:
        list_cases()
    else:
        run_bench(cases=case or [], as_json=as_json, threads=threads, repeats=repeats, out=out)


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="Result folder.", show_default=False)],
    b: Annotated[Path, typer.Argument(metavar="B", help="Result folder of the same scene.", show_default=False)],
    as_json: Annotated[bool, typer.Option("--json", help="Everything as JSON.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the table as CSV, too.")] = None,
    gate: Annotated[
        float | None, typer.Option(min=0.0, metavar="PERCENT", help="End with 1 where an RMSE grew by more than this.")
    ] = None,
) -> None:
    """Compare the errors and times of two runs, label by label, with confidence intervals."""
    from experiments.commands.compare import compare_folders

    if not compare_folders(a, b, as_json=as_json, out=out, gate=gate):
        raise typer.Exit(1)


@app.command("new-technique")
def new_technique(
    name: Annotated[str, typer.Argument(metavar="NAME", help="In snake_case, such as my_pcf.", show_default=False)],
    folder: Annotated[Path, typer.Option("--dir", metavar="DIR", help="Where to write NAME.py.")] = Path(),
) -> None:
    """Write a technique that runs as it stands, to be changed into your own."""
    from experiments.commands.new_technique import write_technique

    write_technique(name, folder)


def main() -> None:
    """Runs the command line and ends the process with its exit status."""
    from experiments.commands.failures import report_failure, stdout_told, warnings_shown_once

    try:
        with warnings_shown_once(), stdout_told():
            app(prog_name="wkernels")
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:
        sys.exit(report_failure(error))


if __name__ == "__main__":
    main()
