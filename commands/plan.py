"""`hrt plan`: the path that collects the most score within a budget."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.plan import PlanDocument, TeamPlanDocument
    from hrt_cli.artifacts.stage import Existing
    from hrt_cli.planning.stage import Planned

METHODS = ("refined", "policy", "policy-sample", "greedy", "rectangle", "lawnmower", "spiral", "random")


@click.command(
    cls=Command,
    sections={
        "Way": "--start --end --return-home --budget --speed --connectivity",
        "Team and earlier drives": "--robots --visited --or-stay",
        "Planner": "--method --objective --gamma --policy --effort --samples --seed",
    },
    files="With --robots, the plans of the robots stand beside the output, as PLAN-1.json, PLAN-2.json, ...",
    keys=(
        "output",
        "up_to_date",
        "method",
        "score",
        "discounted_score",
        "upper_bound",
        "gap",
        "steps",
        "length_m",
        "time_s",
        "start",
        "waypoints",
        "seconds",
    ),
    see_also=("scoremap", "export", "evaluate plan", "drive"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 5
  hrt scoremap site/classes.tif -o site/scoremap.tif
  hrt plan site/scoremap.tif -o site/plan.json --start auto --budget 200
  hrt plan site/scoremap.tif -o site/team.json --start auto --budget 100 --robots 2 --return-home
""",
)
@click.argument("scoremap", type=opt.SCOREMAP)
@opt.output("PLAN.json")
@click.option(
    "--start",
    "starts",
    metavar="PLACE",
    multiple=True,
    help="cell:ROW,COL, lonlat:LON,LAT, xy:X,Y (the map's CRS), or auto; with --robots once, or once for each.",
)
@click.option(
    "--budget",
    metavar="BUDGET",
    required=True,
    help="Steps (250), metres (400m) or minutes (15min, with --speed).",
)
@click.option(
    "--method",
    type=click.Choice(METHODS),
    default="refined",
    show_default=True,
    help="refined collects the most; the others are to compare with.",
)
@click.option(
    "--objective",
    type=click.Choice(["total", "discounted"]),
    default="total",
    show_default=True,
    help="The sum of the scores, or of gamma^t times the score collected at step t.",
)
@click.option(
    "--gamma", type=opt.FiniteFloat(0, 1, low_open=True), default=0.99, show_default=True, help="Discount per step."
)
@click.option(
    "--connectivity",
    type=click.Choice(["4", "8"]),
    default="4",
    show_default=True,
    help="Cells beside one that a move leads to.",
)
@click.option("--return-home", is_flag=True, help="End where the path starts.")
@click.option(
    "--end", "ends", metavar="PLACE", multiple=True, help="Where the path must end, as for --start. Default: anywhere."
)
@click.option(
    "--robots",
    type=click.IntRange(1, 64),
    default=1,
    show_default=True,
    help="Share the cells out among so many robots, each with the whole budget; their plans stand beside OUTPUT.",
)
@click.option(
    "--visited",
    type=opt.LOG,
    multiple=True,
    help="Log (any that `hrt inspect` takes) of a drive to go on from: cells it went through pay nothing, what it "
    "spent is taken off the budget, cells where it got stuck become no-go; one for all robots, one for each, or all "
    "of one robot's.",
)
@click.option(
    "--or-stay", is_flag=True, help="With no move left (budget spent, walled in), plan to stay; else refused."
)
@click.option(
    "--speed",
    "speed_m_s",
    type=opt.FiniteFloat(0.01, 50),
    default=1.0,
    show_default=True,
    help="Speed of the robot, for a budget in minutes and the time it takes.",
)
@click.option(
    "--policy",
    "policy_paths",
    type=opt.POLICY,
    multiple=True,
    help="Trained policy: of several the best walk counts. Default: the two that ship with hrt.",
)
@click.option(
    "--effort", type=opt.FiniteFloat(0.01, 1000), default=1.0, show_default=True, help="Compute spent on refinement."
)
@click.option(
    "--samples", type=click.IntRange(1, 100_000), default=256, show_default=True, help="Rollouts of policy-sample."
)
@opt.seed_opt
@opt.figure_opt
@opt.backdrop_opt
@opt.existing_options
@opt.console_options
def plan(
    scoremap: Path,
    output: Path,
    starts: tuple[str, ...],
    budget: str,
    method: str,
    objective: str,
    gamma: float,
    connectivity: str,
    return_home: bool,
    ends: tuple[str, ...],
    robots: int,
    visited: tuple[Path, ...],
    or_stay: bool,
    speed_m_s: float,
    policy_paths: tuple[Path, ...],
    effort: float,
    samples: int,
    seed: int,
    figure: Path | None,
    backdrop: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Plan the path that collects the most score within a budget.

    SCOREMAP is the output of `hrt scoremap` (or an .npz with score, and optionally sd, cell_size_m, no_go). The plan
    says how far it is from the best possible: its gap to a proven upper bound.
    """
    from hrt_cli.planning.request import PlanRequest, parse_budget, parse_start
    from hrt_cli.planning.stage import plan_file

    request = PlanRequest(
        starts=tuple(parse_start(text) for text in starts),
        budget=parse_budget(budget),
        method=method,
        objective=cast(Literal["total", "discounted"], objective),
        gamma=gamma,
        connectivity=8 if connectivity == "8" else 4,
        return_home=return_home,
        ends=tuple(parse_start(text, "--end") for text in ends),
        robots=robots,
        speed_m_s=speed_m_s,
        effort=effort,
        samples=samples,
        seed=seed,
        or_stay=or_stay,
    )
    with console.bar("plan") as progress:
        done = plan_file(
            scoremap,
            output,
            request,
            policy_paths=policy_paths,
            visited=visited,
            existing=existing,
            progress=progress,
        )
    for note in done.notes:
        console.note(f"Note: {note}")
    if figure is not None:
        from hrt_cli.report.figures.maps import draw_plan

        draw_plan(output, scoremap, figure, backdrop=backdrop, existing=existing)
    found, waypoints = done.document, sum(len(each.waypoints) for each in done.robots)
    state = "up to date" if done.up_to_date else f"{done.seconds:.1f} s"
    team = f"{robots} robots, " if robots > 1 else ""
    console.result(
        f"{output}: {found.method}, {team}{_value(found)}, "
        f"{found.steps} steps, {found.length_m:.0f} m, {waypoints} waypoints ({state})",
        {
            "output": str(output),
            "up_to_date": done.up_to_date,
            "method": found.method,
            "score": found.score,
            "discounted_score": found.discounted_score,
            "upper_bound": found.upper_bound,
            "gap": found.gap,
            "discounted_upper_bound": found.discounted_upper_bound,
            "discounted_gap": found.discounted_gap,
            "steps": found.steps,
            "length_m": found.length_m,
            "time_s": found.time_s,
            "start": list(done.robots[0].start),
            "waypoints": waypoints,
            "seconds": done.seconds,
        }
        | ({} if robots == 1 else {"robots": _robots(output, done)}),
    )


def _robots(output: Path, done: Planned) -> list[dict[str, object]]:
    """Say what each robot of a team does; its score is what it adds to the team's."""
    from hrt_cli.artifacts.plan import TeamPlanDocument

    team = cast(TeamPlanDocument, done.document)
    return [
        {
            "output": str(output.with_name(member.plan)),
            "start": list(member.start),
            "score": member.score,
            "steps": member.steps,
            "length_m": member.length_m,
            "time_s": member.time_s,
            "waypoints": member.waypoints,
        }
        for member in team.robots
    ]


def _value(found: PlanDocument | TeamPlanDocument) -> str:
    """Say what the plan is worth in terms of what it was planned for."""
    if found.discounted_upper_bound is None:
        return f"score {found.score:.2f} of at most {found.upper_bound:.2f} (gap {found.gap:.1%})"
    most = f"at most {found.discounted_upper_bound:.2f} (gap {found.discounted_gap:.1%})"
    return f"discounted score {found.discounted_score:.2f} of {most}, score {found.score:.2f}"
