"""`hrt evaluate`: measure what a stage made; each kind of artifact has a file of its own beside this one."""

from __future__ import annotations

import click

from hrt_cli.lazy import LazyGroup

KINDS = {
    "segment": (
        "hrt_commands.evaluate_segment:segment",
        "Compare CLASSES with TRUTH, two class rasters on the same grid, whatever numbers their classes bear.",
    ),
    "plan": (
        "hrt_commands.evaluate_plan:plan",
        "Value PLANS on SCOREMAP afresh, beside the planner, lawnmower, rectangle, greedy, spiral, random and the "
        "bound.",
    ),
    "runs": ("hrt_commands.evaluate_runs:runs", "Put PLANS of several sites and seeds side by side."),
    "drive": ("hrt_commands.evaluate_drive:drive", "Measure the drives in LOGS, in order, of one robot."),
    "steer": (
        "hrt_commands.evaluate_steer:steer",
        "Measure MODEL, a .safetensors or an exported .onnx, on the recordings in the folders DATA.",
    ),
}


@click.group(
    cls=LazyGroup,
    table=KINDS,
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 6
  hrt evaluate segment site/classes.tif site/truth.tif
""",
)
def evaluate() -> None:
    """Measure a segmentation, plans, drives or a steering model."""
