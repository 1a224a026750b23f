# What the workflows share: the settings, checked, and the options of hrt that they become. It holds no rules.
import csv
import re
from pathlib import Path

import yaml
from jsonschema import ValidationError
from snakemake.exceptions import WorkflowError
from snakemake.utils import validate


def check(settings, schema, where):
    """Refuse settings that the schema does not allow, in a line that names the key."""
    try:
        validate(settings, schema)
    except WorkflowError as error:
        found = error.__context__
        if not isinstance(found, ValidationError):
            raise
        key = "".join(f"{part}: " for part in found.absolute_path)
        about = f" ({found.schema['description']})" if "description" in found.schema else ""
        raise WorkflowError(f"{where}: {key}{found.message}{about}") from None


def words(value):
    """What a key lists: a YAML list, or words separated by blanks."""
    return [str(each) for each in value] if isinstance(value, list) else str("" if value is None else value).split()


def read_sites(path):
    """The sites of a tab-separated table by name, each the settings of config.yaml with its own in their places."""
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise WorkflowError(f"{path}: the table of sites cannot be read: {error.strerror}") from error
    sites = {}
    for row in csv.DictReader([line for line in lines if line and not line.startswith("#")], delimiter="\t"):
        name = str(row.get("site"))
        if None in row or None in row.values():
            raise WorkflowError(f"{path}: site {name!r}: more or fewer cells than the table has columns")
        try:
            given = {key: text if key == "site" else yaml.safe_load(text) for key, text in row.items()}
        except yaml.YAMLError as error:
            raise WorkflowError(f"{path}: site {name!r}: a cell is no YAML", error) from error
        check(given, "sites.schema.yaml", f"{path}: site {name!r}")
        if name in sites:
            raise WorkflowError(f"{path}: site {name!r}: there are two of that name")
        sites[name] = config | given
    if not sites:
        raise WorkflowError(f"{path}: no sites")
    return sites


def check_once(path):
    """Refuse settings of which one stands there twice: YAML takes the last without a word."""
    keys = re.findall(r"^([a-z_]+):", Path(path).read_text(encoding="utf-8"), re.MULTILINE)
    if twice := [key for key in keys if keys.count(key) > 1]:
        raise WorkflowError(f"{path}: {twice[0]}: stands there twice")


def check_files(settings, where):
    """Refuse files that are not there: snakemake would leave what was made without them as if it were up to date."""
    lists = ("keep_out", "policy")
    for key in ("ortho", "scores", "aoi", "keep_out", "dsm", "interest", "model", "policy"):
        for path in words(settings.get(key)) if key in lists else filter(None, [settings.get(key)]):
            if not Path(path).exists() and (key, path) != ("policy", "train"):
                raise WorkflowError(f"{where}: {key}: no such file: {path}")


def at(wildcards):
    """The settings of the site that a job is for."""
    return SITES[wildcards.get("site", "")]


def any_of(names):
    """The wildcard constraint that only these names meet."""
    return "|".join(map(re.escape, names)) or "(?!)"


def option(settings, name, key):
    """An option of hrt and its value, where the key has one."""
    return "" if settings.get(key) is None else f"{name} {settings[key]}"


def options(*parts):
    """Options one after the other."""
    return " ".join(filter(None, parts))


def needed(*keys):
    """Refuse a configuration that leaves one of the keys empty."""
    for key in keys:
        if config.get(key) is None:
            raise WorkflowError(f"config.yaml: {key} is needed here, and empty")


def of_one_site():
    """Refuse several sites and seeds."""
    for key in ("sites", "seeds"):
        if config.get(key) is not None:
            raise WorkflowError(f"config.yaml: {key} must be empty here: this workflow is of one site and one seed")


def limits(settings):
    """The files of the area of interest and the keep-outs."""
    return [path for key in ("aoi", "keep_out") for path in words(settings.get(key))]


def layers(settings):
    """The files that lie beside the classes on the scoremap."""
    return limits(settings) + [settings[key] for key in ("dsm", "interest") if settings.get(key)]


def limit_args(settings):
    """Where the robot may go."""
    keep_out = [f"--keep-out {path}" for path in words(settings.get("keep_out"))]
    return options(option(settings, "--aoi", "aoi"), *keep_out)


def cell_args(settings):
    """How the cells of a scoremap are made."""
    below = option(settings, "--no-go-below", "no_go_below")
    parts = [f"--cell {settings['cell_m']}", option(settings, "--explore", "explore"), limit_args(settings), below]
    if below:
        parts.append(option(settings, "--no-go-share", "no_go_share"))
    if below or limits(settings):
        parts.append(option(settings, "--margin", "margin_m"))
    parts.append(option(settings, "--dsm", "dsm"))
    if settings.get("interest"):
        parts += [
            option(settings, "--interest", "interest"),
            option(settings, "--interest-range", "interest_range"),
            option(settings, "--interest-weight", "interest_weight"),
            option(settings, "--interest-radius", "interest_radius_m"),
            option(settings, "--thermal-units", "thermal_units"),
        ]
    return options(*parts)


def planner_args(settings, seed):
    """How the planner works."""
    policies = [f"--policy {path}" for path in POLICIES]
    return options(f"--method {settings['method']} --speed {settings['speed_m_s']} --seed {seed}", *policies)


def plan_args(wildcards):
    """What a plan is for, and how it is made."""
    settings = at(wildcards)
    how = planner_args(settings, wildcards.get("seed", config["seed"]))
    return f"--start {settings['start']} --budget {settings['budget']} {how}"


def export_args(settings):
    """What a mission is written for."""
    what = f"--vehicle {settings['vehicle']} --speed {settings['speed_m_s']}"
    return options(what, limit_args(settings), option(settings, "--tolerance", "tolerance_m"))


def model_of(wildcards):
    """The texture model that a site is given, none where one is fitted to it."""
    return given_model(wildcards.get("site", ""))


def given_model(site):
    """The same by the site's name."""
    if config.get("model"):
        return [config["model"]]
    return [f"{OUT}/{config['model_from']}/model.npz"] if config.get("model_from") not in (None, site) else []


def labels(what, *, of_seed=False):
    """How the report tells figures of the same kind apart."""
    site = {"site": "{site}"} if "{site}" in PLACE else {}
    seed = {"seed": "{seed}"} if of_seed and "{seed}" in RUN else {}
    return site | seed | {"shows": what}


# `--config aoi=` empties a key, as `aoi:` does.
config.update({key: None for key, value in config.items() if value == ""})
check_once("config.yaml")
check(config, "config.schema.yaml", "config.yaml")

OUT = config["out"]
SITES = read_sites(config["sites"]) if config.get("sites") else {"": config}
SEEDS = words(config.get("seeds"))
# One site and one seed have no folders of their own.
PLACE = f"{OUT}/{{site}}" if config.get("sites") else OUT
RUN = f"{PLACE}/seed-{{seed}}" if SEEDS else PLACE
POLICIES = [f"{OUT}/policy.npz"] if config.get("policy") == "train" else words(config.get("policy"))
if config.get("model_from") not in (None, *SITES):
    raise WorkflowError(f"config.yaml: model_from: there is no site {config['model_from']!r} in the table of sites")
if config.get("model") and config.get("model_from"):
    raise WorkflowError("config.yaml: model and model_from: give one of them")
if len(set(SEEDS)) < len(SEEDS):
    raise WorkflowError("config.yaml: seeds: one of them stands there twice")
for site, settings in SITES.items():
    check_files(settings, f"{config['sites']}: site {site!r}" if site else "config.yaml")
