# A robot learns to steer from a survey, before it has driven a metre: snakemake -s steer.smk --cores 2 --config world=../site
#
# As in steer.mk: glances at random places; round 1 shows besides how the expert drives, in each later round the robot
# itself drives and is corrected; it learns from all so far, and is tested on courses that it has not seen.
# From several sites (steer_worlds) it learns likewise: each has glances of its own, and the drives go by turns over all.
include: "Snakefile"
include: "steer_common.smk"


wildcard_constraints:
    round="[0-9]+",
    drive="[0-9]+",


localrules:
    steering,
    test_report,


rule steering:
    """A robot that learnt to steer, tested on courses that it has not seen."""
    default_target: True
    input:
        f"{STEER}/test/report.json",


for site, world in enumerate(WORLDS, start=1):

    rule:
        name:
            f"glances_{site}"
        # What the robot would see at random places of a site, and how to steer there.
        input:
            site_of(world),
        output:
            f"{glances_of(site)}/labels.csv",
        log:
            f"{STEER}/logs/glances-{site}.log",
        benchmark:
            f"{STEER}/benchmarks/glances-{site}.tsv"
        resources:
            mem_mb=lambda wildcards, attempt: 1000 * attempt,
            runtime=lambda wildcards, attempt: 120 * attempt,
        params:
            world=world,
            folder=glances_of(site),
            what=f"--frames {int(config['steer_glances']) // len(WORLDS)} --near {config['steer_near']}",
            seed=int(config["seed"]) + site - 1,
        shell:
            "hrt record {params.world} -o {params.folder} {params.what} --seed {params.seed} --overwrite 2>&1 | tee {log}"


rule learning_drive:
    """What the robot saw on a drive, and what the expert did or would have done there."""
    input:
        world=lambda wildcards: site_of(world_of(wildcards.drive)),
        model=lambda wildcards: model_before(wildcards.round),
    output:
        labels=f"{STEER}/round-{{round}}/drive-{{drive}}/labels.csv",
        log=f"{STEER}/round-{{round}}/drive-{{drive}}.jsonl",
    log:
        f"{STEER}/logs/round-{{round}}/drive-{{drive}}.log",
    benchmark:
        f"{STEER}/benchmarks/round-{{round}}/drive-{{drive}}.tsv"
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=lambda wildcards, attempt: 120 * attempt,
    params:
        world=lambda wildcards: world_of(wildcards.drive),
        metres=config["steer_metres"],
        folder=lambda wildcards: f"{STEER}/round-{wildcards.round}/drive-{wildcards.drive}",
        driver=lambda wildcards: driver(wildcards.round),
        seed=lambda wildcards: int(config["seed"]) * 100000 + int(wildcards.round) * 1000 + int(wildcards.drive),
    shell:
        "hrt drive --world {params.world} --roam {params.metres} -o {output.log} --record {params.folder}"
        " {params.driver} --seed {params.seed} --overwrite 2>&1 | tee {log}"


rule learn:
    """The network after a round, learnt from all recordings so far."""
    input:
        labels=lambda wildcards: recordings(wildcards.round),
        model=lambda wildcards: model_before(wildcards.round),
    output:
        model=f"{STEER}/round-{{round}}/steer.safetensors",
        curve=report(
            f"{STEER}/round-{{round}}/curve.png",
            caption="report/steering.rst",
            category="Steering",
            labels={"round": "{round}", "shows": "training"},
        ),
    log:
        f"{STEER}/logs/round-{{round}}/learn.log",
    benchmark:
        f"{STEER}/benchmarks/round-{{round}}/learn.tsv"
    threads: config["workers"]
    resources:
        mem_mb=lambda wildcards, attempt: 4000 * attempt,
        runtime=lambda wildcards, attempt: 600 * attempt,
    params:
        data=lambda wildcards: " ".join(str(Path(each).parent) for each in recordings(wildcards.round)),
        init=lambda wildcards: " ".join(f"--init {each}" for each in model_before(wildcards.round)),
        how=lambda wildcards: how_to_learn(wildcards.round),
    shell:
        "hrt train-steer {params.data} -o {output.model} {params.how} --threads {threads} {params.init}"
        " --curve {output.curve} --overwrite 2>&1 | tee {log}"


rule test_drive:
    """A drive of the robot that has learnt, on a course that it has not seen."""
    input:
        model=f"{STEER}/round-{LEARN_ROUNDS[-1]}/steer.safetensors",
        world=site_of(TEST_WORLD),
    output:
        f"{STEER}/test/drive-{{drive}}.jsonl",
    log:
        f"{STEER}/logs/test/drive-{{drive}}.log",
    benchmark:
        f"{STEER}/benchmarks/test/drive-{{drive}}.tsv"
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=lambda wildcards, attempt: 120 * attempt,
    params:
        world=TEST_WORLD,
        metres=config["steer_metres"],
        seed=lambda wildcards: int(config["seed"]) * 100000 + 99000 + int(wildcards.drive),
    shell:
        "hrt drive --world {params.world} --roam {params.metres} -o {output} --local steer --model {input.model}"
        " --seed {params.seed} --overwrite 2>&1 | tee {log}"


rule test_report:
    """How far and how safely it drove."""
    input:
        logs=expand(f"{STEER}/test/drive-{{d}}.jsonl", d=range(1, int(config["steer_test_drives"]) + 1)),
        world=site_of(TEST_WORLD),
    output:
        report(
            f"{STEER}/test/report.json", caption="report/steering.rst", category="Steering", labels={"shows": "test"}
        ),
    log:
        f"{STEER}/logs/test/report.log",
    benchmark:
        f"{STEER}/benchmarks/test/report.tsv"
    resources:
        mem_mb=1000,
        runtime=30,
    params:
        world=TEST_WORLD,
    shell:
        "hrt evaluate drive {input.logs} --world {params.world} --json -q > {output} 2> {log}"
