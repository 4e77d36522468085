"""Finding the files that an SDF world includes: ``model://`` names, files beside it, and models downloaded before."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import unquote, urlparse

from navsim.convert.errors import ConversionError
from navsim.convert.xmlfile import read_xml

PATH_VARIABLES = ("GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "SDF_PATH", "GAZEBO_MODEL_PATH")
"""Environment variables of Gazebo's that list directories with models."""
_CACHES = ("~/.gz/fuel", "~/.ignition/fuel", "~/.gazebo/models")
"""Where Gazebo keeps what it has downloaded."""


class ModelFinder:
    """Where models are looked for.

    Args:
        model_paths: directories that hold models, looked into first.
    """

    def __init__(self, model_paths: Sequence[str | os.PathLike[str]] = ()) -> None:
        self._paths = [Path(path).expanduser() for path in model_paths]
        for variable in PATH_VARIABLES:
            self._paths += [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]

    def find(self, uri: str, beside: Path) -> Path | None:
        """The SDF file of a model, or the file that a URI names; None when there is none on this machine.

        Args:
            uri: as an ``<include>`` or a mesh says it.
            beside: the file that says so.
        """
        for candidate in self._candidates(uri.strip(), beside):
            try:
                if candidate.is_file():
                    return candidate
                if candidate.is_dir():
                    found = _model_file(candidate)
                    if found is not None:
                        return found
            except (OSError, ValueError):  # a name that no file can have
                continue
        return None

    def _candidates(self, uri: str, beside: Path) -> Iterator[Path]:
        if not uri or "\0" in uri:
            return
        try:
            parsed = urlparse(uri)
        except ValueError:
            return
        scheme, rest = parsed.scheme.lower(), unquote(uri.partition("://")[2])
        if scheme in ("", "file") and "://" not in uri:
            yield beside.parent / uri.removeprefix("file:")
        elif scheme == "file":
            yield Path(rest)
            yield beside.parent / rest.lstrip("/")
        if scheme in ("", "model", "package"):
            name = rest if "://" in uri else uri
            for directory in self._paths:
                yield directory / name
            for parent in list(beside.parents)[:4]:
                yield parent / name
                yield parent / "models" / name
            if scheme == "package":  # the package's own directory is not part of what it holds
                yield from self._candidates("model://" + name.partition("/")[2], beside)
        if scheme in ("http", "https"):
            yield from self._downloaded(parsed.netloc, unquote(parsed.path))
            name = Path(unquote(parsed.path)).name
            for variant in dict.fromkeys((name, name.lower(), name.lower().replace(" ", "_"))):
                for directory in self._paths:
                    yield directory / variant
        if scheme == "model":
            for cache in _CACHES:
                yield Path(cache).expanduser() / rest

    def _downloaded(self, host: str, path: str) -> Iterator[Path]:
        """A model of Gazebo Fuel, ``/1.0/OWNER/models/NAME``, in the newest version that was downloaded."""
        parts = path.lower().strip("/").split("/")
        if len(parts) < 4 or parts[2] != "models":
            return
        for cache in _CACHES[:2]:
            directory = Path(cache).expanduser() / host.lower() / parts[1] / "models" / parts[3]
            if directory.is_dir():
                versions = [entry for entry in directory.iterdir() if entry.name.isdigit()]
                yield from sorted(versions, key=lambda entry: -int(entry.name))


def _model_file(directory: Path) -> Path | None:
    """The SDF file of a model's directory: what ``model.config`` names for the newest version, or ``model.sdf``."""
    for name in ("model.config", "manifest.xml"):
        config = directory / name
        if config.is_file():
            try:
                listed = [(_version(entry.attributes.get("version", "")), entry.text.strip())
                          for entry in read_xml(config).all("sdf")]  # fmt: skip
            except ConversionError:
                listed = []
            for _, file in sorted(listed, reverse=True):
                if (directory / file).is_file():
                    return directory / file
    plain = directory / "model.sdf"
    return plain if plain.is_file() else None


def _version(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split(".") if part.isdigit() and len(part) < 9)
