"""What mkdocs adds to the reference: the help of the commands, settings from their classes, known cameras."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import is_dataclass
from importlib import import_module
from itertools import groupby
from typing import Annotated, Any, Literal, get_args, get_origin

import click
from pydantic.fields import FieldInfo

import cli
from disk.preset_files import data_folder

_WIDTH = 90  # letters in a line of help


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Hook of mkdocs: replaces ``::: help COMMAND``, ``::: settings module.Class`` and ``::: cameras``."""
    markdown = re.sub(r"^::: help (\S+)$", lambda found: _commands(found[1]), markdown, flags=re.M)
    markdown = re.sub(r"^::: cameras$", lambda _: _cameras(), markdown, flags=re.M)
    return re.sub(r"^::: settings (\S+)$", lambda found: _settings(found[1]), markdown, flags=re.M)


def _cameras() -> str:
    """The sidecar of each known format; its lines of comments become text."""
    found = []
    for file in sorted(data_folder("captures").glob("*.toml")):
        found.append(f"## {file.stem}")
        for is_text, lines in groupby(file.read_text().splitlines(), lambda line: line.startswith("#")):
            part = list(lines)
            text = " ".join(line.removeprefix("# ") for line in part)
            code = "\n".join(part).strip("\n")
            found.append(text if is_text else f"```toml\n{code}\n```" if code else "")
    return "\n\n".join(found)


def _commands(program: str) -> str:
    command = getattr(cli, program.replace("-", "_"))
    return "\n".join(_help(program, command, None))


def _help(name: str, command: click.Command, above: click.Context | None) -> Iterator[str]:
    context = click.Context(
        command, info_name=name, parent=above, max_content_width=_WIDTH, terminal_width=_WIDTH
    )
    yield f"{'##' if above is None else '###'} {context.command_path}\n"
    yield f"```text\n{command.get_help(context)}\n```\n"
    for each, below in sorted(getattr(command, "commands", {}).items()):
        yield from _help(each, below, context)


def _settings(place: str) -> str:
    module, _, name = place.rpartition(".")
    return "\n".join(_group(getattr(import_module(module), name), ""))


def _group(cls: type, prefix: str) -> Iterator[str]:
    """The text of a class, a list of its settings, and the same for each group among them."""
    about, described = _docstring(cls)
    yield f"{about}\n"
    groups = []
    checked: dict[str, FieldInfo] = cls.__pydantic_fields__  # type: ignore[attr-defined]
    for name, info in checked.items():
        key = f"{prefix}{name}"
        kinds = list(dict.fromkeys(_classes(info.annotation)))
        if kinds:
            groups += [(key, kind) for kind in kinds]
            continue
        default = info.get_default(call_default_factory=True)
        value = "required" if info.is_required() else f"default `{_plain(default)}`"
        text = " ".join((info.description or described.get(name, "")).split())
        kind = Annotated[(info.annotation, *info.metadata)] if info.metadata else info.annotation
        yield f"- **`{key}`** ({', '.join(_kind(kind))}; {value}){'. ' if text else ''}{text}"
    for key, kind in groups:
        words = (
            key if len({each for other, each in groups if other == key}) == 1 else f"{key}: {kind.__name__}"
        )
        yield f"\n### {words}\n"
        yield from _group(kind, f"{key}.")


def _docstring(cls: type) -> tuple[str, dict[str, str]]:
    """The text of a class without its sections, and what its section Attributes says of each name."""
    about, *sections = re.split(r"\n\n(?=[A-Z][a-z]+\n-{4,}\n)", inspect.getdoc(cls) or "")
    described = {}
    for section in sections:
        if section.startswith("Attributes\n"):
            for names, text in re.findall(r"^(\w+(?:, \w+)*) : (.*(?:\n    .*)*)", section, re.M):
                described |= dict.fromkeys(names.split(", "), text)
    return about, described


def _classes(annotation: Any) -> Iterator[type]:
    """The groups of settings that a type consists of: a class, or one of several."""
    if is_dataclass(annotation) and isinstance(annotation, type):
        yield annotation
    elif get_origin(annotation) is not Literal:
        for part in get_args(annotation):
            yield from _classes(part)


def _kind(annotation: Any) -> Iterator[str]:
    """Type and bounds as words."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        yield from _kind(parts[0])
        marks = [mark for part in parts[1:] for mark in getattr(part, "metadata", [part])]
        for name, sign in (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤")):
            yield from (f"{sign} {getattr(mark, name):g}" for mark in marks if hasattr(mark, name))
    elif origin is Literal:
        yield " or ".join(f"`{part}`" for part in parts)
    elif origin is tuple:
        yield "list of " + ", ".join(
            " ".join(_kind(part)) for part in dict.fromkeys(parts) if part is not ...
        )
    elif origin is not None:
        yield " or ".join(" ".join(_kind(part)) for part in parts)
    else:
        yield {type(None): "none"}.get(annotation, getattr(annotation, "__name__", str(annotation)))


def _plain(value: Any) -> str:
    """A default as TOML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_plain, value))}]"
    return f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value)
