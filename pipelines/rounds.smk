# A robot works in rounds and learns as it drives, as in rounds.mk: snakemake -s rounds.smk --cores 2
#
# With robot=real a missing drive stops the workflow until it is driven. A drive.jsonl that `hrt drive` did not write is
# never replaced or deleted, whatever becomes of its plan.
import re
import zlib
from pathlib import Path

from snakemake.exceptions import WorkflowError


include: "Snakefile"


if config["robot"] not in ("simulated", "real"):
    raise WorkflowError(f"config.yaml: robot is simulated or real, not {config['robot']!r}")
if config["robot"] == "simulated" and not config.get("world"):
    raise WorkflowError("config.yaml: the simulated robot needs a world: the folder of a site, as `hrt synth` makes one")

ROUNDS = range(1, int(config["rounds"]) + 1)
LEGS = [f"round-{r}/leg-{l}" for r in ROUNDS for l in range(1, int(config["legs"]) + 1)]
BUDGET, UNIT = re.fullmatch(r"([0-9.]+)(.*)", str(config["round_budget"])).groups()
WORLD = config.get("world") or ""
WORLD_FILES = [
    f"{WORLD}/{name}"
    for name in ("ortho.tif", "ortho.vrt", "dsm.tif", "truth.tif", "classes.tif", "world.json")
    if WORLD and Path(WORLD, name).is_file()
]
PLANNER = f"--method {config['method']} --speed {config['speed_m_s']} --seed {config['seed']}"


def is_driven(leg):
    """Whether a real robot drove the leg: then its log has no provenance."""
    log = Path(leg, "drive.jsonl")
    return log.is_file() and b'"provenance"' not in log.read_bytes()


DRIVEN = [leg for leg in LEGS if is_driven(leg)]
# What is no output of any rule is never replaced.
KEPT = [leg for leg in LEGS if Path(leg, "drive.jsonl").is_file()] if config["robot"] == "real" else DRIVEN


def any_of(legs):
    """The wildcard constraint that only these legs meet."""
    return "|".join(map(re.escape, legs)) or "(?!)"


def number(leg):
    """Round and leg as numbers."""
    return tuple(map(int, re.findall("[0-9]+", leg)))


def before(leg):
    """The logs of the legs before, in order."""
    return [f"{each}/drive.jsonl" for each in LEGS[: LEGS.index(leg)]]


def so_far(leg):
    """Those and its own."""
    return [*before(leg), f"{leg}/drive.jsonl"]


def learnt(leg):
    """The scores that the leg before left, or what was known at the start."""
    return [log.replace("drive.jsonl", "scores.json") for log in before(leg)[-1:]] or SCORES


def of_round(number_of_round):
    """The logs of a round."""
    return [f"{leg}/drive.jsonl" for leg in LEGS if number(leg)[0] == int(number_of_round)]


def contents(logs):
    """Checksums of the real robot's drives: one copied with its time may be older than what it replaces."""
    return [zlib.crc32(Path(log).read_bytes()) for log in logs if log.removesuffix("/drive.jsonl") in DRIVEN]


def plan_args(leg):
    """Where the robot stands, and the budget: cumulative, twice 5min after the second round."""
    stands = [f"--visited {log}" for log in before(leg)] or [f"--start {config['start']}"]
    return " ".join([*stands, f"--or-stay --budget {number(leg)[0] * float(BUDGET):g}{UNIT}", PLANNER])


wildcard_constraints:
    leg=any_of(LEGS),
    round="[0-9]+",


rule rounds:
    default_target: True
    input:
        expand("round-{round}/{name}", round=ROUNDS, name=("report.json", "plan.png")),
        expand("{leg}/plan.json", leg=LEGS),
        f"{LEGS[-1]}/scores.json",


rule leg_scoremap:
    input:
        classes=f"{OUT}/classes.tif",
        scores=lambda wildcards: learnt(wildcards.leg),
        layers=LIMITS + LAYERS,
    output:
        "{leg}/scoremap.tif",
    params:
        cells=CELLS,
        scores=lambda wildcards: " ".join(f"--scores {path}" for path in learnt(wildcards.leg)),
    shell:
        "hrt scoremap {input.classes} -o {output} {params.cells} {params.scores} --overwrite -q"


rule leg_plan:
    input:
        scoremap="{leg}/scoremap.tif",
        logs=lambda wildcards: before(wildcards.leg),
    output:
        "{leg}/plan.json",
    params:
        plan=lambda wildcards: plan_args(wildcards.leg),
        contents=lambda wildcards: contents(before(wildcards.leg)),
    shell:
        "hrt plan {input.scoremap} -o {output} {params.plan} --overwrite"


# The first plan of a round is drawn by the command that made it, which finds it up to date.
rule round_figure:
    input:
        scoremap="round-{round}/leg-1/scoremap.tif",
        plan="round-{round}/leg-1/plan.json",
        ortho=config["ortho"],
    output:
        "round-{round}/plan.png",
    params:
        plan=lambda wildcards: plan_args(f"round-{wildcards.round}/leg-1"),
    shell:
        "hrt plan {input.scoremap} -o {input.plan} {params.plan} --figure {output} --backdrop {input.ortho} --overwrite"


if config["robot"] == "simulated":

    rule leg_drive:
        input:
            plan="{leg}/plan.json",
            after=lambda wildcards: before(wildcards.leg)[-1:],
            world=WORLD_FILES,
        output:
            "{leg}/drive.jsonl",
        wildcard_constraints:
            leg=any_of([leg for leg in LEGS if leg not in KEPT]),
        params:
            world=WORLD,
            local=config["local"],
            after=lambda wildcards: " ".join(f"--after {log}" for log in before(wildcards.leg)[-1:]),
            seed=lambda wildcards: int(config["seed"]) * 1000 + number(wildcards.leg)[0] * 50 + number(wildcards.leg)[1],
            contents=lambda wildcards: contents(before(wildcards.leg)[-1:]),
        shell:
            "hrt drive {input.plan} --world {params.world} {params.after} -o {output} --local {params.local}"
            " --seed {params.seed} --overwrite"

else:

    rule leg_drive:
        input:
            plan="{leg}/plan.json",
            after=lambda wildcards: before(wildcards.leg)[-1:],
        output:
            "{leg}/drive.jsonl",
        wildcard_constraints:
            leg=any_of([leg for leg in LEGS if leg not in KEPT]),
        params:
            after=lambda wildcards: " ".join(f"--after {log}" for log in before(wildcards.leg)[-1:]),
        shell:
            """
            if grep -q '"method": "stay"' {input.plan}; then
              hrt drive {input.plan} --stay {params.after} -o {output}
            else
              echo 'Error: {output}: no such log: let the robot drive {input.plan}, put its log there and run again' >&2
              exit 1
            fi
            """


rule leg_feedback:
    input:
        classes=f"{OUT}/classes.tif",
        scores=SCORES,
        logs=lambda wildcards: so_far(wildcards.leg),
    output:
        "{leg}/scores.json",
    params:
        scores=option("--scores", "scores"),
        contents=lambda wildcards: contents(so_far(wildcards.leg)),
    shell:
        "hrt feedback {input.logs} --classes {input.classes} {params.scores} -o {output} --overwrite -q"


rule report:
    input:
        logs=lambda wildcards: of_round(wildcards.round),
        scoremap=f"round-{{round}}/leg-{config['legs']}/scoremap.tif",
        world=WORLD_FILES,
    output:
        "round-{round}/report.json",
    params:
        world=f"--world {WORLD}" if WORLD else "",
        contents=lambda wildcards: contents(of_round(wildcards.round)),
    shell:
        "hrt evaluate drive {input.logs} {params.world} --scoremap {input.scoremap} --json -q > {output}"
