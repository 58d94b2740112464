"""Reading YAML files into models, with file, line and column in every error.

PyYAML composes the nodes. They become plain data in which every scalar stays the text that stands
in the file: YAML's own rules would read `off` as false and 010 as 8. What a text means follows from
the type of the field it is read into (`field_types`). The models are dataclasses that pydantic
validates. Pydantic reports a mistake by its path; the node at that path has the line and column.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Final, NoReturn, TypeVar, get_args, get_origin, get_type_hints

import yaml
from pydantic import AliasPath, ConfigDict, GetCoreSchemaHandler, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError
from pydantic_core.core_schema import (
    no_info_after_validator_function,
    no_info_plain_validator_function,
    with_info_plain_validator_function,
)

from lecombus.errors import DescriptionError

__all__ = [
    "FILE_TABLE",
    "Document",
    "Place",
    "Quoted",
    "ReadAs",
    "Reads",
    "mistake",
    "without_keys",
]

LOADER: type = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

DEEPEST: Final = 20
"""Deepest nesting read; no file here needs more than 8."""

KEY: Final = "[key]"
"""The last step of a path, as pydantic has it, where a table's key is meant and not its value."""

FILE_TABLE: Final = ConfigDict(extra="forbid")
"""`__pydantic_config__` of a dataclass that a table of a file is read into."""

T = TypeVar("T")
Path = tuple[int | str, ...]


class Quoted(str):
    """A scalar in quotes: never a number, true or false."""

    __slots__ = ()


@dataclass(frozen=True)
class Reads:
    """Marks a field that a function reads; pydantic's own `PlainValidator` takes twice as long.

    Args:
        read: Makes the value of the plain data; given the manual's name too if `sourced`.
    """

    read: Callable[..., object]
    sourced: bool = False

    def __get_pydantic_core_schema__(self, _: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate by the function alone."""
        if self.sourced:
            return with_info_plain_validator_function(
                lambda given, info: self.read(given, info.context)
            )
        return no_info_plain_validator_function(self.read)


@dataclass(frozen=True)
class ReadAs:
    """Marks a field whose form in the file differs from the value that is kept.

    Args:
        form: The type that the file is read into.
        made: Makes the value of it.
    """

    form: Any
    made: Callable[[Any], object]

    def __get_pydantic_core_schema__(self, _: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate the file's form, then make the value."""
        return no_info_after_validator_function(self.made, handler.generate_schema(self.form))


def mistake(message: str, *below: int | str) -> PydanticCustomError:
    """Return the error that a validator raises.

    Args:
        message: What is wrong and what would be right.
        below: Path of the wrong value below the one that is validated.
    """
    return PydanticCustomError("mistake", "{message}", {"message": message, "below": below})


def without_keys(kind: type[T], entry: T) -> T:
    """Return what a file's entry describes, without the keys that its subclass adds."""
    return kind(**{one.name: getattr(entry, one.name) for one in fields(kind)})  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class Place:
    """A value of a document, by its path."""

    document: Document
    path: Path

    def fail(self, message: str, *below: int | str, code: str = "") -> NoReturn:
        """Refuse this value, or one below it.

        Raises:
            DescriptionError: Always.
        """
        raise self.document.error(message, *self.path, *below, code=code)


class Document:
    """A YAML file.

    Args:
        text: Its content.
        file: Its name, for errors.
        family: The family being read, for errors.
        untrusted: A user's file: its depth is checked before it is composed.

    Raises:
        DescriptionError: It is no YAML, nests too deep, is no table, or a key stands in it twice.
    """

    def __init__(self, text: str, file: str, *, family: str = "", untrusted: bool = False) -> None:
        self._file = file
        self._family = family
        self._root: yaml.Node | None = None
        try:
            if untrusted:
                self._refuse_deep(text)
            self._root = yaml.compose(text, Loader=LOADER)
        except yaml.YAMLError as exc:
            problem = getattr(exc, "problem", None) or exc
            mark = getattr(exc, "problem_mark", None)
            raise self._error_at(f"this is no YAML: {problem}", mark) from exc
        if self._root is None:
            raise self._error_at("the file is empty", None)
        self._done: dict[int, object] = {}  # an alias is the same node again
        data = self._plain(self._root)
        if not isinstance(data, dict):
            raise self.error(TABLE_RIGHT)
        self.data: Mapping[str, Any] = data

    def read(self, kind: type[T], *, manual: str = "") -> T:
        """Validate the document.

        Args:
            kind: Its model.
            manual: The manual that its sources stand in.

        Raises:
            DescriptionError: Something in it is wrong; of several mistakes the first in the file.
        """
        model: Any = kind
        try:
            found: T = _validator(model).validate_python(self.data, context=manual)
        except ValidationError as exc:
            mistakes = [(_path(one), one) for one in exc.errors(include_url=False)]
        else:
            return found
        path, first = min(mistakes, key=lambda one: self._position(one[0]))
        raise self.error(_message(first, kind), *path, value=first["input"])

    def place(self, *path: int | str) -> str:
        """Return where a value stands: `FILE:LINE:COLUMN`."""
        line, column = self._position(path)
        return f"{self._file}:{line}:{column}"

    def error(
        self, message: str, *path: int | str, code: str = "", value: object = None
    ) -> DescriptionError:
        """Return the error of the value at a path."""
        return self._error_at(message, self._node(path).start_mark, path, code, value)

    def _error_at(
        self, message: str, mark: Any, path: Path = (), code: str = "", value: object = None
    ) -> DescriptionError:
        return DescriptionError(
            message,
            file=self._file,
            where=f"{mark.line + 1}:{mark.column + 1}" if mark else "",
            drive_type=self._family,
            code=code,
            path=".".join(str(one) for one in path if one != KEY),
            value=value,
        )

    def _position(self, path: Path) -> tuple[int, int]:
        mark = self._node(path).start_mark
        return mark.line + 1, mark.column + 1

    def _node(self, path: Path) -> yaml.Node:
        """Find the node at a path, passing over the steps that the file does not have.

        Such steps are a key that is missing, whose table is then meant, and the branch of a union.
        """
        assert self._root is not None
        node = self._root
        for number, step in enumerate(path):
            if isinstance(node, yaml.MappingNode):
                for key, value in node.value:
                    if key.value == step:
                        node = key if path[number + 1 :] == (KEY,) else value
                        break
            elif isinstance(node, yaml.SequenceNode) and isinstance(step, int):
                node = node.value[step]
        return node

    def _plain(self, node: yaml.Node) -> object:
        """Turn a node into a dictionary, a list or the text of a scalar."""
        if isinstance(node, yaml.ScalarNode):
            return Quoted(node.value) if node.style else node.value
        if id(node) in self._done:
            return self._done[id(node)]
        if isinstance(node, yaml.SequenceNode):
            items: list[object] = []
            self._done[id(node)] = items
            items += map(self._plain, node.value)
            return items
        table: dict[str, object] = {}
        self._done[id(node)] = table
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise self._error_at(TEXT_RIGHT, key.start_mark)
            if key.value in table:
                raise self._error_at(f"{key.value} stands here twice", key.start_mark)
            table[key.value] = self._plain(value)
        return table

    def _refuse_deep(self, text: str) -> None:
        """Refuse a text that nests deeper than any such file: the composer recurses, in C too."""
        depth = 0
        for event in yaml.parse(text, Loader=LOADER):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                message = f"lists and tables nest more than {DEEPEST} deep here"
                raise self._error_at(message, event.start_mark)


@cache
def _validator(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


TEXT_RIGHT: Final = "a text is right here"
TABLE_RIGHT: Final = "a table of keys and values is right here"
LIST_RIGHT: Final = "a list is right here"
MESSAGES: Final = {
    "dataclass_type": TABLE_RIGHT,
    "dict_type": TABLE_RIGHT,
    "tuple_type": LIST_RIGHT,
    "frozen_set_type": LIST_RIGHT,
    "string_type": TEXT_RIGHT,
}
"""What is right where pydantic found something of another kind."""


def _path(error: ErrorDetails) -> Path:
    """Return the path of the wrong value, of a key that is not known the key's."""
    path = error["loc"] + tuple(error.get("ctx", {}).get("below", ()))
    return (*path, KEY) if error["type"] == "unexpected_keyword_argument" else path


def _message(error: ErrorDetails, kind: type) -> str:
    """Say in plain words what is wrong and what would be right."""
    *above, last = error["loc"]
    if error["type"] == "missing":
        return f"{last} is missing"
    if error["type"] == "unexpected_keyword_argument":
        return f"{last} is not known here; {', '.join(sorted(_known_keys(kind, above)))} are"
    if error["type"] in ("enum", "literal_error"):
        expected = error["ctx"]["expected"].replace(" or ", ", ").replace("'", "")
        return f"{error['input']} is not known here; {expected} are"
    return MESSAGES.get(error["type"], error["msg"])


def _known_keys(kind: type, path: list[int | str]) -> dict[str, Any]:
    """Return the keys of the table at a path with their types."""
    known = _keys(kind)
    for step in path:
        table = _table_in(known.get(str(step)))
        known = _keys(table) if table is not None else known
    return known


def _table_in(kind: Any) -> Any:
    """Return the dataclass that a type's tables are read into; None where it has none."""
    for mark in getattr(kind, "__metadata__", ()):
        if isinstance(mark, ReadAs):
            return _table_in(mark.form)
    if is_dataclass(kind):
        return kind
    return next((found for one in get_args(kind) if (found := _table_in(one)) is not None), None)


def _keys(table: Any) -> dict[str, Any]:
    """Return the keys of a dataclass's table: the names of its fields, or their aliases."""
    keys: dict[str, Any] = {}
    for name, kind in get_type_hints(table, include_extras=True).items():
        alias: Any = name
        marks = get_args(kind)[1:] if get_origin(kind) is Annotated else ()
        for mark in marks:
            if isinstance(mark, FieldInfo) and mark.validation_alias is not None:
                alias = mark.validation_alias
        keys[str(alias.path[0] if isinstance(alias, AliasPath) else alias)] = kind
    return keys
