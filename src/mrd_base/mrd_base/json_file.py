"""JSON result files, checked on writing and on reading against the schema in the package that writes them."""

import json
import math
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import jsonschema

from mrd_base.errors import InputError
from mrd_base.text_file import read_text_file


def read_schema(package: str, name: str) -> Any:
    """Read the JSON Schema of ``name``.json, which the package ``package`` writes."""
    return json.loads(resources.files(package).joinpath(f"schemas/{name}.schema.json").read_text())


def make_folder(path: str) -> Path:
    """Make the folder of the results; called before the computation, so that it is not lost where nothing can be written.

    Raises
    ------
    InputError
        When nothing can be written there.
    """
    if not path:
        raise InputError("--output is empty, expected a folder for the results")
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".writable").touch()
        (folder / ".writable").unlink()
    except OSError as error:
        raise InputError(f"--output {path}: cannot be written ({error.strerror}), expected a folder") from None
    return folder


def write_json(content: Mapping[str, Any], package: str, name: str, folder: str | Path) -> Path:
    """Check ``content`` against the schema of ``package`` and write ``name``.json into ``folder``.

    The file is complete or absent, even when the process is interrupted. Returns the path of the file.
    """
    jsonschema.validate(content, read_schema(package, name))
    path = Path(folder) / f"{name}.json"
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return partial.replace(path)


def read_json(path: str | Path, package: str, name: str, version: str) -> Any:
    """Read a file that `write_json` wrote as ``name``.json with this version of the schema.

    Raises
    ------
    InputError
        When the file cannot be read, or is not such a file.
    """
    try:
        content = json.loads(read_text_file(Path(path), f"a {name}.json"))
        schema = content.get("schema") if isinstance(content, dict) else None
        if schema != version:
            raise InputError(f"{path}: its schema is {str(schema)[:40]}, expected a {name}.json of {version}")
        jsonschema.validate(content, read_schema(package, name))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path}: is not JSON ({error})") from None
    except jsonschema.ValidationError as error:
        field = "/".join(map(str, error.absolute_path)) or "the file"
        message = error.message.splitlines()[0][:200]
        raise InputError(f"{path}: {field}: {message}; expected a {name}.json of {version}") from None
    return content


def finite_or_none(value: float) -> float | None:
    """Return the value, or None (null in JSON) where it is not finite."""
    return value if math.isfinite(value) else None
