# From which sites, in which rounds and drives a robot learns to steer. It holds no rules.
of_one_site()
needed(
    *(f"steer_{key}" for key in ("glances", "near", "rounds", "drives", "metres", "disturb", "size", "crop", "columns"))
)
needed(*(f"steer_{key}" for key in ("batch", "rate", "balance", "sigma", "epochs", "test_drives")))
WORLD = config.get("world")
if not WORLD:
    raise WorkflowError("config.yaml: to learn to steer, a robot needs a world: a folder with ortho.tif and dsm.tif")
WORLDS = [WORLD, *words(config.get("steer_worlds"))]
TEST_WORLD = config.get("steer_test_world") or WORLD
STEER = f"{OUT}/steer"
LEARN_ROUNDS = range(1, int(config["steer_rounds"]) + 1)
DRIVES = range(1, int(config["steer_drives"]) + 1)


def by_round(key):
    """The numbers that a key of the configuration lists, one for each round."""
    found = words(config[key])
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


def recordings(number):
    """The recordings to learn from in a round."""
    sites = range(1, len(WORLDS) + 1) if int(config["steer_glances"]) else []
    rounds = range(1, int(number) + 1)
    glances = [f"{glances_of(site)}/labels.csv" for site in sites]
    return glances + expand(f"{STEER}/round-{{r}}/drive-{{d}}/labels.csv", r=rounds, d=DRIVES)


def model_before(number):
    """The model of the round before, if there is one."""
    return [f"{STEER}/round-{int(number) - 1}/steer.safetensors"] if int(number) > 1 else []


def driver(number):
    """Who drives in a round."""
    if int(number) == 1:
        return f"--local teacher --disturb {config['steer_disturb']}"
    return f"--local steer --model {model_before(number)[0]} --rescue"


def how_to_learn(number):
    """The options of the training in a round."""
    number = int(number) - 1
    return (
        f"--balance {config['steer_balance']} --size {config['steer_size']} --crop-top {config['steer_crop']}"
        f" --columns {config['steer_columns']} --batch {config['steer_batch']} --sigma {config['steer_sigma']}"
        " --share 0.1 --patience 0"
        f" --epochs {EPOCHS[number]} --learning-rate {RATES[number]} --seed {config['seed']}"
    )
