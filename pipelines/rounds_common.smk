# What the rounds are, told from the settings and from the drives that are there. It holds no rules.
import zlib

of_one_site()
needed("robot", "rounds", "legs", "round_budget", "local")
if config["robot"] == "simulated" and not config.get("world"):
    raise WorkflowError(
        "config.yaml: the simulated robot needs a world: the folder of a site, as `hrt synth` makes one"
    )

ROUNDS = range(1, int(config["rounds"]) + 1)
LEGS = [f"round-{r}/leg-{leg}" for r in ROUNDS for leg in range(1, int(config["legs"]) + 1)]
BUDGET, UNIT = re.fullmatch(r"([0-9.]+)(.*)", str(config["round_budget"])).groups()
WORLD = config.get("world") or ""
WORLD_FILES = [
    f"{WORLD}/{name}"
    for name in ("ortho.tif", "ortho.vrt", "dsm.tif", "truth.tif", "classes.tif", "world.json")
    if WORLD and Path(WORLD, name).is_file()
]


def is_driven(leg):
    """Whether a real robot drove the leg: then its log has no provenance."""
    log = Path(leg, "drive.jsonl")
    return log.is_file() and b'"provenance"' not in log.read_bytes()


DRIVEN = [leg for leg in LEGS if is_driven(leg)]
# What is no output of any rule is never replaced.
KEPT = [leg for leg in LEGS if Path(leg, "drive.jsonl").is_file()] if config["robot"] == "real" else DRIVEN


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
    return [log.replace("drive.jsonl", "scores.json") for log in before(leg)[-1:]] or words(config.get("scores"))


def of_round(number_of_round):
    """The logs of a round."""
    return [f"{leg}/drive.jsonl" for leg in LEGS if number(leg)[0] == int(number_of_round)]


def contents(logs):
    """Checksums of the real robot's drives: one copied with its time may be older than what it replaces."""
    return [zlib.crc32(Path(log).read_bytes()) for log in logs if log.removesuffix("/drive.jsonl") in DRIVEN]


def leg_plan_args(leg):
    """Where the robot stands, and the budget: cumulative, twice 5min after the second round."""
    stands = [f"--visited {log}" for log in before(leg)] or [f"--start {config['start']}"]
    budget = f"{number(leg)[0] * float(BUDGET):g}{UNIT}"
    return options(*stands, f"--or-stay --budget {budget}", planner_args(config, config["seed"]))
