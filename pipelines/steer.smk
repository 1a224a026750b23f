# A robot learns to steer from a survey, before it has driven a metre: snakemake -s steer.smk --cores 2 --config world=../site
#
# As in steer.mk: glances at random places; round 1 shows besides how the expert drives, in each later round the robot
# itself drives and is corrected; it learns from all so far, and is tested on courses that it has not seen.
# From several sites (steer_worlds) it learns likewise: each has glances of its own, and the drives go by turns over all.
from pathlib import Path

from snakemake.exceptions import WorkflowError


include: "Snakefile"


WORLD = config.get("world")
if not WORLD:
    raise WorkflowError("config.yaml: to learn to steer, a robot needs a world: a folder with ortho.tif and dsm.tif")
WORLDS = [WORLD, *str(config.get("steer_worlds") or "").split()]
TEST_WORLD = config.get("steer_test_world") or WORLD
STEER = f"{OUT}/steer"
LEARN_ROUNDS = range(1, int(config["steer_rounds"]) + 1)
DRIVES = range(1, int(config["steer_drives"]) + 1)


def by_round(key):
    """The numbers that a key of the configuration lists, one for each round."""
    found = str(config[key]).split()
    if len(found) < len(LEARN_ROUNDS):
        raise WorkflowError(f"config.yaml: {key} needs a number for each of the {len(LEARN_ROUNDS)} rounds")
    return found


EPOCHS, RATES = by_round("steer_epochs"), by_round("steer_rate")


def site_of(world):
    """The files of a site."""
    names = ("ortho.tif", "ortho.vrt", "dsm.tif", "truth.tif", "classes.tif", "world.json")
    return [f"{world}/{name}" for name in names if Path(world, name).is_file()]


def glances_of(number):
    """The folder of the glances of a site."""
    return f"{STEER}/glances" + (f"-{number}" if int(number) > 1 else "")


def world_of(drive):
    """The site of a drive."""
    return WORLDS[(int(drive) - 1) % len(WORLDS)]


def labels(number):
    """The recordings to learn from in a round."""
    sites = range(1, len(WORLDS) + 1) if int(config["steer_glances"]) else []
    return [f"{glances_of(site)}/labels.csv" for site in sites] + expand(f"{STEER}/round-{{r}}/drive-{{d}}/labels.csv", r=range(1, int(number) + 1), d=DRIVES)


def model_before(number):
    """The model of the round before, if there is one."""
    return [f"{STEER}/round-{int(number) - 1}/steer.safetensors"] if int(number) > 1 else []


def driver(number):
    """Who drives in a round."""
    if int(number) == 1:
        return f"--local teacher --disturb {config['steer_disturb']}"
    return f"--local steer --model {model_before(number)[0]} --rescue"


wildcard_constraints:
    round="[0-9]+",
    drive="[0-9]+",


rule steering:
    default_target: True
    input:
        f"{STEER}/test/report.json",


for site, world in enumerate(WORLDS, start=1):

    rule:
        name:
            f"glances_{site}"
        input:
            site_of(world),
        output:
            f"{glances_of(site)}/labels.csv",
        params:
            world=world,
            folder=glances_of(site),
            what=f"--frames {int(config['steer_glances']) // len(WORLDS)} --near {config['steer_near']}",
            seed=int(config["seed"]) + site - 1,
        shell:
            "hrt record {params.world} -o {params.folder} {params.what} --seed {params.seed} --overwrite"


rule learning_drive:
    input:
        world=lambda wildcards: site_of(world_of(wildcards.drive)),
        model=lambda wildcards: model_before(wildcards.round),
    output:
        labels=f"{STEER}/round-{{round}}/drive-{{drive}}/labels.csv",
        log=f"{STEER}/round-{{round}}/drive-{{drive}}.jsonl",
    params:
        world=lambda wildcards: world_of(wildcards.drive),
        metres=config["steer_metres"],
        folder=lambda wildcards: f"{STEER}/round-{wildcards.round}/drive-{wildcards.drive}",
        driver=lambda wildcards: driver(wildcards.round),
        seed=lambda wildcards: int(config["seed"]) * 100000 + int(wildcards.round) * 1000 + int(wildcards.drive),
    shell:
        "hrt drive --world {params.world} --roam {params.metres} -o {output.log} --record {params.folder}"
        " {params.driver} --seed {params.seed} --overwrite"


rule learn:
    input:
        labels=lambda wildcards: labels(wildcards.round),
        model=lambda wildcards: model_before(wildcards.round),
    output:
        model=f"{STEER}/round-{{round}}/steer.safetensors",
        curve=f"{STEER}/round-{{round}}/curve.png",
    params:
        data=lambda wildcards: " ".join(str(Path(each).parent) for each in labels(wildcards.round)),
        init=lambda wildcards: " ".join(f"--init {each}" for each in model_before(wildcards.round)),
        how=lambda wildcards: (
            f"--balance {config['steer_balance']} --size {config['steer_size']} --crop-top {config['steer_crop']}"
            f" --columns {config['steer_columns']} --batch {config['steer_batch']} --sigma {config['steer_sigma']}"
            " --share 0.1 --patience 0"
            f" --epochs {EPOCHS[int(wildcards.round) - 1]} --learning-rate {RATES[int(wildcards.round) - 1]}"
            f" --seed {config['seed']}"
        ),
    threads: config["workers"]
    shell:
        "hrt train-steer {params.data} -o {output.model} {params.how} --threads {threads} {params.init}"
        " --curve {output.curve} --overwrite"


rule test_drive:
    input:
        model=f"{STEER}/round-{LEARN_ROUNDS[-1]}/steer.safetensors",
        world=site_of(TEST_WORLD),
    output:
        f"{STEER}/test/drive-{{drive}}.jsonl",
    params:
        world=TEST_WORLD,
        metres=config["steer_metres"],
        seed=lambda wildcards: int(config["seed"]) * 100000 + 99000 + int(wildcards.drive),
    shell:
        "hrt drive --world {params.world} --roam {params.metres} -o {output} --local steer --model {input.model}"
        " --seed {params.seed} --overwrite"


rule test_report:
    input:
        logs=expand(f"{STEER}/test/drive-{{d}}.jsonl", d=range(1, int(config["steer_test_drives"]) + 1)),
        world=site_of(TEST_WORLD),
    output:
        f"{STEER}/test/report.json",
    params:
        world=TEST_WORLD,
    shell:
        "hrt evaluate drive {input.logs} --world {params.world} --json -q > {output}"
