"""A steering model in a file: safetensors, with configuration and provenance in its header.

All metadata is one JSON string under the key `hrt`: the safetensors library keeps several keys in no fixed order, and
equal models must be equal bytes.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Literal

import torch
from pydantic import JsonValue, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from hrt_cli.artifacts.carriers import checked, parse_provenance
from hrt_cli.artifacts.jsonio import Document, canonical, describe, parse_strict
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import publishing
from hrt_cli.errors import InputError
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet
from hrt_cli.steering.network.signals import undivided

FORMAT, VERSION = "hrt-steering", 1
_KEY = "hrt"
MAX_BYTES = 2 * 2**30


class _Header(Document):
    format: Literal["hrt-steering"]
    version: Literal[1]
    config: SteeringConfig
    training: dict[str, JsonValue] | None = None
    provenance: Provenance


def publish_model(
    target: Path,
    net: SteeringNet,
    config: SteeringConfig,
    provenance: Provenance,
    training: dict[str, Any] | None = None,
) -> None:
    """Publish a network's weights with its configuration.

    Parameters
    ----------
    config : SteeringConfig
        What to write as the network's: it may say more than `net.config`, such as temperatures.
    training : dict, optional
        How it was trained, as JSON values: for people and figures; no prediction depends on it.
    """
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in net.state_dict().items()}
    document = {"format": FORMAT, "version": VERSION, "config": _plain(config)}
    publish_tensors(target, tensors, document | ({"training": training} if training else {}), provenance)


def read_model(path: Path, *, as_it_stands: bool = False) -> SteeringNet:
    """Read a steering model, ready to predict on the CPU; `as_it_stands` as in `read_tensors`.

    Raises
    ------
    InputError
        It is absent, no steering model, of a later version, damaged, or its weights do not fit its configuration or
        are not finite.
    """
    tensors, document, provenance = read_tensors(path, as_it_stands=as_it_stands)
    if document.get("format") != FORMAT:
        raise InputError(path, "is not a steering model of hrt")
    version = document.get("version")
    if isinstance(version, int) and version > VERSION:
        raise InputError(path, f"is of version {version}; this hrt reads versions up to {VERSION}", "update hrt")
    try:
        header = _Header.model_validate_json(
            json.dumps(document | {"provenance": provenance.model_dump(mode="json") if provenance else None})
        )
    except ValidationError as error:
        raise InputError(path, describe(error)) from error
    net = SteeringNet(header.config)
    wanted = net.state_dict()
    for name in sorted(set(wanted) ^ set(tensors)):
        raise InputError(path, f"{'lacks' if name in wanted else 'holds the unknown'} weights {name!r}")
    for name, tensor in tensors.items():
        if tensor.shape != wanted[name].shape or tensor.dtype != wanted[name].dtype:
            raise InputError(path, f"its weights {name!r} are not of the shape and type that its configuration asks")
        if not torch.isfinite(tensor).all():
            raise InputError(path, f"its weights {name!r} are not all finite")
    net.load_state_dict(tensors)
    return net.eval()


def model_provenance(path: Path) -> Provenance | None:
    """Read the provenance of a steering model and check its content against it."""
    return read_tensors(path)[2]


def read_training(path: Path) -> dict[str, Any] | None:
    """Read how a steering model was trained, as `publish_model` was told; None where it does not say."""
    found = read_tensors(path)[1].get("training")
    return found if isinstance(found, dict) else None


def publish_tensors(target: Path, tensors: dict[str, Tensor], document: dict[str, Any], provenance: Provenance) -> None:
    """Publish tensors and a JSON document as safetensors with their provenance.

    Parameters
    ----------
    tensors : dict of str to Tensor
        Contiguous, on the CPU.
    """
    stamped = provenance.with_content(_content_sha256(tensors, document))
    text = canonical({**document, "provenance": stamped.model_dump(mode="json")}).decode()
    with publishing(target, model_provenance) as draft:
        draft.touch()
        mode = draft.stat().st_mode
        with undivided():
            save_file(tensors, draft, metadata={_KEY: text})
        draft.chmod(mode)  # the library's own is 0600, whatever the user's umask


def read_tensors(
    path: Path, *, as_it_stands: bool = False
) -> tuple[dict[str, Tensor], dict[str, Any], Provenance | None]:
    """Read what `publish_tensors` wrote: tensors, document, and provenance, against which both are checked.

    The document is empty, and there is no provenance, in a file that another program wrote. Read `as_it_stands` they
    are not checked, for what only tells of them.

    Raises
    ------
    InputError
        It is absent or no such file, or not as it was written.
    """
    if not path.is_file():
        raise InputError(path, "no such file")
    if path.stat().st_size > MAX_BYTES:
        raise InputError(path, f"is larger than the {MAX_BYTES} bytes that are read")
    try:
        # A signal in the midst of the library would come out of it as an error of the file.
        with undivided(), safe_open(path, framework="pt", device="cpu") as file:
            text = (file.metadata() or {}).get(_KEY)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    except (SafetensorError, OSError, ValueError, RuntimeError) as error:
        raise InputError(path, "is no safetensors file, or a damaged one") from error
    if text is None:  # another program's
        return tensors, {}, None
    document = parse_strict(path, text)
    if not isinstance(document, dict):
        raise InputError(path, "its header is damaged")
    found = document.pop("provenance", None)
    if found is None:
        return tensors, document, None
    provenance = parse_provenance(path, found)
    if as_it_stands:
        return tensors, document, provenance
    return tensors, document, checked(path, provenance, _content_sha256(tensors, document))


def _content_sha256(tensors: dict[str, Tensor], document: dict[str, Any]) -> str:
    digest = hashlib.sha256(canonical(document))
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(canonical([name, str(tensor.dtype), list(tensor.shape)]))
        digest.update(tensor.contiguous().view(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def _plain(config: SteeringConfig) -> dict[str, Any]:
    plain: dict[str, Any] = json.loads(config.model_dump_json())
    return plain
