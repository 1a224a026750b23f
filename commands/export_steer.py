"""`hrt export-steer`: a steering model becomes an ONNX file."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing
    from hrt_cli.steering.onnx.export import SteerExport


@click.command(
    "export-steer",
    cls=Command,
    keys=("output", "up_to_date", "precision", "size_bytes", "comparison"),
    see_also=("train-steer", "steer"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 30
  hrt drive --world site --roam 30 --local expert --disturb 0.3 --record site/frames -o site/drive.jsonl
  hrt train-steer site/frames -o site/steer.safetensors --size 64x48 --epochs 1
  hrt export-steer site/steer.safetensors -o site/steer.onnx --int8 --calibrate site/frames
""",
)
@click.argument("model", type=opt.STEERING)
@opt.output("MODEL.onnx")
@click.option("--int8", is_flag=True, help="In 8-bit integers: a quarter of the size, about twice as fast.")
@click.option(
    "--calibrate",
    "calibration",
    multiple=True,
    type=opt.PATH,
    help="Folder of recordings, or a picture file, to calibrate --int8 on and to compare on.",
)
@opt.skip_bad_opt
@opt.existing_options
@opt.console_options
def export_steer(
    model: Path,
    output: Path,
    int8: bool,
    calibration: tuple[Path, ...],
    skip_bad: bool,
    existing: Existing,
    console: Console,
) -> None:
    """Write a steering MODEL as ONNX, which robots run without PyTorch.

    Pictures go in as bytes and probabilities come out: normalisation and temperatures are in the graph, and the file
    says in plain English how to feed it. Before it is written it is run by onnxruntime and compared with the model: on
    the recordings given, else on made-up pictures. Needs pip install 'hrt[onnx]'.
    """
    from hrt_cli.steering.onnx.export import export_onnx

    with console.bar("export-steer") as progress:
        done = export_onnx(
            model,
            output,
            int8=int8,
            calibration=calibration,
            skip_bad=skip_bad,
            existing=existing,
            progress=progress,
            note=console.note,
        )
    console.result(
        f"{output}: {_line(done)}",
        {
            "output": str(output),
            "up_to_date": done.up_to_date,
            "precision": "int8" if int8 else "float32",
            "size_bytes": done.size_bytes,
            "comparison": None if done.comparison is None else asdict(done.comparison),
        },
    )


def _line(done: SteerExport) -> str:
    size = f"{done.size_bytes / 1e6:.1f} MB"
    found = done.comparison
    if found is None:
        return f"{size}, up to date"
    parts = [size, f"probabilities within {found.max_difference:.2g} of the model's on {found.frames} frames"]
    if found.mae_before is not None:
        parts.append(f"MAE {found.mae_after:.4f} (the model: {found.mae_before:.4f})")
    return ", ".join(parts)
