# A robot works in rounds and learns as it drives, as in rounds.mk: snakemake -s rounds.smk --cores 2
#
# With robot=real a missing drive stops the workflow until it is driven. A drive.jsonl that `hrt drive` did not write is
# never replaced or deleted, whatever becomes of its plan.
include: "Snakefile"
include: "rounds_common.smk"


localrules:
    rounds,
    round_figure,
    leg_feedback,
    round_report,


wildcard_constraints:
    leg=any_of(LEGS),
    round="[0-9]+",


rule rounds:
    """Every leg of every round planned, driven and learnt from."""
    default_target: True
    input:
        expand("round-{round}/{name}", round=ROUNDS, name=("report.json", "plan.png")),
        expand("{leg}/plan.json", leg=LEGS),
        f"{LEGS[-1]}/scores.json",


rule leg_scoremap:
    """What is known when the leg is planned, as a map."""
    input:
        classes=f"{OUT}/classes.tif",
        scores=lambda wildcards: learnt(wildcards.leg),
        layers=layers(config),
    output:
        "{leg}/scoremap.tif",
    log:
        f"{OUT}/logs/{{leg}}/scoremap.log",
    benchmark:
        f"{OUT}/benchmarks/{{leg}}/scoremap.tsv"
    resources:
        mem_mb=lambda wildcards, attempt: 1000 * attempt,
        runtime=lambda wildcards, attempt: 30 * attempt,
    params:
        cells=cell_args(config),
        scores=lambda wildcards: " ".join(f"--scores {path}" for path in learnt(wildcards.leg)),
    shell:
        "hrt scoremap {input.classes} -o {output} {params.cells} {params.scores} --overwrite -q 2>&1 | tee {log}"


rule leg_plan:
    """A path for the budget that is left, from where the robot stands."""
    input:
        scoremap="{leg}/scoremap.tif",
        logs=lambda wildcards: before(wildcards.leg),
        policies=POLICIES,
    output:
        "{leg}/plan.json",
    log:
        f"{OUT}/logs/{{leg}}/plan.log",
    benchmark:
        f"{OUT}/benchmarks/{{leg}}/plan.tsv"
    resources:
        mem_mb=lambda wildcards, attempt: 1000 * attempt,
        runtime=lambda wildcards, attempt: 60 * attempt,
    params:
        plan=lambda wildcards: leg_plan_args(wildcards.leg),
        contents=lambda wildcards: contents(before(wildcards.leg)),
    shell:
        "hrt plan {input.scoremap} -o {output} {params.plan} --overwrite 2>&1 | tee {log}"


# The first plan of a round is drawn by the command that made it, which finds it up to date.
rule round_figure:
    """The first plan of a round over the orthomosaic."""
    input:
        scoremap="round-{round}/leg-1/scoremap.tif",
        plan="round-{round}/leg-1/plan.json",
        ortho=config["ortho"],
    output:
        report(
            "round-{round}/plan.png",
            caption="report/round.rst",
            category="Rounds",
            labels={"round": "{round}", "shows": "first plan"},
        ),
    log:
        f"{OUT}/logs/round-{{round}}/figure.log",
    benchmark:
        f"{OUT}/benchmarks/round-{{round}}/figure.tsv"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        plan=lambda wildcards: leg_plan_args(f"round-{wildcards.round}/leg-1"),
    shell:
        "hrt plan {input.scoremap} -o {input.plan} {params.plan} --figure {output} --backdrop {input.ortho} --overwrite"
        " 2>&1 | tee {log}"


if config["robot"] == "simulated":

    rule leg_drive:
        """The drive of the simulated robot."""
        input:
            plan="{leg}/plan.json",
            after=lambda wildcards: before(wildcards.leg)[-1:],
            world=WORLD_FILES,
        output:
            "{leg}/drive.jsonl",
        log:
            f"{OUT}/logs/{{leg}}/drive.log",
        benchmark:
            f"{OUT}/benchmarks/{{leg}}/drive.tsv"
        wildcard_constraints:
            leg=any_of([leg for leg in LEGS if leg not in KEPT]),
        resources:
            mem_mb=lambda wildcards, attempt: 1000 * attempt,
            runtime=lambda wildcards, attempt: 60 * attempt,
        params:
            world=WORLD,
            local=config["local"],
            after=lambda wildcards: " ".join(f"--after {log}" for log in before(wildcards.leg)[-1:]),
            seed=lambda wildcards: int(config["seed"]) * 1000 + number(wildcards.leg)[0] * 50 + number(wildcards.leg)[1],
            contents=lambda wildcards: contents(before(wildcards.leg)[-1:]),
        shell:
            "hrt drive {input.plan} --world {params.world} {params.after} -o {output} --local {params.local}"
            " --seed {params.seed} --overwrite 2>&1 | tee {log}"

else:

    localrules:
        leg_drive,

    rule leg_drive:
        """The place where the real robot's drive is put: nothing is made here unless the plan is to stay."""
        input:
            plan="{leg}/plan.json",
            after=lambda wildcards: before(wildcards.leg)[-1:],
        output:
            "{leg}/drive.jsonl",
        log:
            f"{OUT}/logs/{{leg}}/drive.log",
        benchmark:
            f"{OUT}/benchmarks/{{leg}}/drive.tsv"
        wildcard_constraints:
            leg=any_of([leg for leg in LEGS if leg not in KEPT]),
        resources:
            mem_mb=500,
            runtime=10,
        params:
            after=lambda wildcards: " ".join(f"--after {log}" for log in before(wildcards.leg)[-1:]),
        shell:
            """
            if grep -q '"method": "stay"' {input.plan}; then
                hrt drive {input.plan} --stay {params.after} -o {output} 2>&1 | tee {log}
            else
                echo 'Error: {output}: no such log: let the robot drive {input.plan}, put its log there and run again' \
                    | tee {log} >&2
                exit 1
            fi
            """


rule leg_feedback:
    """What all drives so far teach about the classes."""
    input:
        classes=f"{OUT}/classes.tif",
        scores=words(config.get("scores")),
        logs=lambda wildcards: so_far(wildcards.leg),
    output:
        "{leg}/scores.json",
    log:
        f"{OUT}/logs/{{leg}}/feedback.log",
    benchmark:
        f"{OUT}/benchmarks/{{leg}}/feedback.tsv"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        scores=option(config, "--scores", "scores"),
        contents=lambda wildcards: contents(so_far(wildcards.leg)),
    shell:
        "hrt feedback {input.logs} --classes {input.classes} {params.scores} -o {output} --overwrite -q 2>&1 | tee {log}"


rule round_report:
    """How far and how safely the robot went in a round, and what it collected."""
    input:
        logs=lambda wildcards: of_round(wildcards.round),
        scoremap=f"round-{{round}}/leg-{config['legs']}/scoremap.tif",
        world=WORLD_FILES,
    output:
        report(
            "round-{round}/report.json",
            caption="report/round.rst",
            category="Rounds",
            labels={"round": "{round}", "shows": "drives"},
        ),
    log:
        f"{OUT}/logs/round-{{round}}/report.log",
    benchmark:
        f"{OUT}/benchmarks/round-{{round}}/report.tsv"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        world=f"--world {WORLD}" if WORLD else "",
        contents=lambda wildcards: contents(of_round(wildcards.round)),
    shell:
        "hrt evaluate drive {input.logs} {params.world} --scoremap {input.scoremap} --json -q > {output} 2> {log}"
