"""Reading YAML files into models, with file, line and column in every error.

PyYAML composes the nodes. They become plain data in which every scalar stays the text that stands
in the file: YAML's own rules would read `off` as false and 010 as 8. What a text means follows from
the type of the field it is read into (`field_types`). The models are dataclasses that pydantic
validates. Pydantic reports a mistake by its path; the node at that path has the line and column.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from importlib import resources
from typing import Any, Final, NoReturn, TypeVar, get_args, get_type_hints

import yaml
from pydantic import (
    AliasPath,
    ConfigDict,
    GetCoreSchemaHandler,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError
from pydantic_core.core_schema import (
    no_info_after_validator_function,
    no_info_plain_validator_function,
    with_info_after_validator_function,
    with_info_plain_validator_function,
)

from lecombus.errors import DescriptionError

__all__ = [
    "FILE_TABLE",
    "KEY",
    "LIST_RIGHT",
    "NOT_A_KEY",
    "TEXT_RIGHT",
    "FileContext",
    "Quoted",
    "ReadAs",
    "ReadBy",
    "ReadFile",
    "YamlFile",
    "by_key",
    "context_of",
    "data_text",
    "mistake",
    "open_data_file",
    "without_keys",
]

LOADER: type = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

DEEPEST: Final = 20
"""Deepest nesting read; no file here needs more than 8."""

KEY: Final = "[key]"
"""The last step of a path, as pydantic has it, where a table's key is meant and not its value."""

FILE_TABLE: Final = ConfigDict(extra="forbid")
"""`__pydantic_config__` of a dataclass that a table of a file is read into."""

E = TypeVar("E")
K = TypeVar("K")
T = TypeVar("T")
Path = tuple[int | str, ...]
ReadFile = Callable[[str], str]
"""Returns the text of a data file by its name with `.yaml`."""


class Quoted(str):
    """A scalar in quotes: never a number, true or false."""

    __slots__ = ()


@dataclass(slots=True)
class FileContext:
    """What is known while a document is read, for the validators of its fields.

    Args:
        manual: The manual that its sources stand in.
        codes: The described codes of the family; empty until they are read.
    """

    manual: str = ""
    codes: Mapping[Any, Any] = field(default_factory=dict)

    def write_class(self, code: object) -> object:
        """Return a code's write class; None where it is not described."""
        return getattr(self.codes.get(code), "write_class", None)


def context_of(info: ValidationInfo) -> FileContext:
    """Return what is known while a document is read."""
    context: Any = info.context
    assert isinstance(context, FileContext)
    return context


@dataclass(frozen=True)
class ReadBy:
    """Marks a field that a function reads; pydantic's own `PlainValidator` takes twice as long.

    Args:
        read: Makes the value of the plain data; it is given the `FileContext` too if `informed`.
    """

    read: Callable[..., object]
    informed: bool = False

    def __get_pydantic_core_schema__(self, _: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate by the function alone."""
        if not self.informed:
            return no_info_plain_validator_function(self.read)
        return with_info_plain_validator_function(
            lambda given, info: self.read(given, info.context)
        )


@dataclass(frozen=True)
class ReadAs:
    """Marks a field whose form in the file differs from the value that is kept.

    Args:
        form: The type that the file is read into.
        made: Makes the value of it; it is given pydantic's `ValidationInfo` too if `informed`.
    """

    form: Any
    made: Callable[..., object]
    informed: bool = False

    def __get_pydantic_core_schema__(self, _: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate the file's form, then make the value."""
        form = handler.generate_schema(self.form)
        if self.informed:
            return with_info_after_validator_function(self.made, form)
        return no_info_after_validator_function(self.made, form)


def mistake(message: str, *below: int | str, code: object = "") -> PydanticCustomError:
    """Return the error that a validator raises.

    Args:
        message: What is wrong and what would be right.
        below: Path of the wrong value below the one that is validated.
        code: The code concerned, if any.
    """
    found = {"message": message, "below": below, "code": str(code)}
    return PydanticCustomError("mistake", "{message}", found)


def _refuse_key(_: object) -> NoReturn:
    raise PydanticCustomError("unexpected_keyword_argument", "this is not a key")


NOT_A_KEY: Final = ReadBy(_refuse_key)
"""Marks a field that no file gives."""


def by_key(
    entries: Iterable[E], key: Callable[[E], K], again: str = "{} stands here twice"
) -> dict[K, E]:
    """Return entries by a key that none of them shares.

    Args:
        entries: The entries, in the order of their list.
        key: Returns the key of one.
        again: What is wrong where two have one key.
    """
    found: dict[K, E] = {}
    for place, entry in enumerate(entries):
        if key(entry) in found:
            raise mistake(again.format(key(entry)), place)
        found[key(entry)] = entry
    return found


def without_keys(kind: type[T], entry: object) -> T:
    """Return what an entry of a file describes, without the keys that only the file has."""
    given: Any = kind
    return kind(**{one.name: getattr(entry, one.name) for one in fields(given) if one.init})


class YamlFile:
    """A YAML file, or a file with those it includes.

    Args:
        text: Its content.
        file: Its name, for errors.
        family: The family being read, for errors.
        untrusted: A user's file: its depth is checked before it is composed.

    Raises:
        DescriptionError: It is not YAML, nests too deep, is not a table, or a key is given twice.
    """

    def __init__(self, text: str, file: str, *, family: str = "", untrusted: bool = False) -> None:
        self._file = file
        self._family = family
        try:
            if untrusted:
                self._refuse_deep(text)
            root = yaml.compose(_Stream(text, file), Loader=LOADER)
        except yaml.YAMLError as exc:
            problem = getattr(exc, "problem", None) or exc
            mark = getattr(exc, "problem_mark", None)
            raise self._error_at(f"this is no YAML: {problem}", mark) from exc
        if root is None:
            raise self._error_at("the file is empty", None)
        if not isinstance(root, yaml.MappingNode):
            raise self._error_at(TABLE_RIGHT, root.start_mark)
        self._root = root
        self._done: dict[int, Any] = {}  # an alias is the same node again

    @property
    def data(self) -> dict[str, Any]:
        """The document as plain data: every scalar is its text."""
        return self._plain_table(self._root)

    def texts(self, key: str) -> list[str]:
        """Return the texts of a list at the top, as far as they are any."""
        node = self._node((key,))
        items = node.value if isinstance(node, yaml.SequenceNode) else ()
        return [one.value for one in items if isinstance(one, yaml.ScalarNode)]

    def include(self, other: YamlFile, lists: Collection[str]) -> None:
        """Add the keys of another document.

        Args:
            other: The other document.
            lists: Keys that both may have; their lists are joined.

        Raises:
            DescriptionError: Both give another key than these.
        """
        own = {name: value for name, _, value in self._pairs(self._root)}
        for name, key, value in self._pairs(other._root):
            if name not in own:
                self._root.value.append((key, value))
            elif name not in lists:
                raise self.error(f"{name} is also given by an included file", name)
            else:
                for one in (own[name], value):
                    if not isinstance(one, yaml.SequenceNode):
                        raise self._error_at(LIST_RIGHT, one.start_mark)
                own[name].value += value.value
        self._done.clear()

    def read(self, kind: type[T]) -> T:
        """Validate the document.

        Args:
            kind: Its model.

        Raises:
            DescriptionError: Something in it is wrong; of several mistakes the first.
        """
        model: Any = kind
        context = FileContext(str(self.data.get("manual", "")))
        try:
            found: T = _validator(model).validate_python(self.data, context=context)
        except ValidationError as exc:
            mistakes = [(_path(one), one) for one in exc.errors(include_url=False)]
        else:
            return found
        # Sections depend on those before them: the first section that is wrong is the one to mend.
        section = mistakes[0][0][:1]
        own = [one for one in mistakes if one[0][:1] == section]
        path, first = min(own, key=lambda one: _order(self._node(one[0]).start_mark))
        code = first.get("ctx", {}).get("code", "")
        raise self.error(_message(first, kind), *path, code=code, value=first["input"])

    def place(self, *path: int | str) -> str:
        """Return where a value stands: `FILE:LINE:COLUMN`."""
        mark = self._node(path).start_mark
        return f"{mark.name}:{mark.line + 1}:{mark.column + 1}"

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
            file=mark.name if mark else self._file,
            where=f"{mark.line + 1}:{mark.column + 1}" if mark else "",
            drive_type=self._family,
            code=code,
            path=".".join(one for one in map(str, path) if not one.startswith("[")),
            value=value,
        )

    def _node(self, path: Path) -> Any:
        """Find the node at a path, passing over the steps that the file does not have.

        Such steps are a key that is missing, whose table is then meant, and the branch of a union.
        """
        node: Any = self._root
        for number, step in enumerate(path):
            if isinstance(node, yaml.MappingNode):
                for key, value in node.value:
                    if key.value == step:
                        node = key if path[number + 1 :] == (KEY,) else value
                        break
            elif isinstance(node, yaml.SequenceNode) and isinstance(step, int):
                node = node.value[step]
        return node

    def _plain(self, node: Any) -> object:
        """Turn a node into a dictionary, a list or the text of a scalar."""
        if isinstance(node, yaml.ScalarNode):
            return Quoted(node.value) if node.style else node.value
        if isinstance(node, yaml.MappingNode):
            return self._plain_table(node)
        if id(node) in self._done:
            return self._done[id(node)]
        items: list[object] = []
        self._done[id(node)] = items
        items += map(self._plain, node.value)
        return items

    def _plain_table(self, node: Any) -> dict[str, Any]:
        table: dict[str, Any]
        if id(node) in self._done:
            table = self._done[id(node)]
            return table
        table = self._done[id(node)] = {}
        for name, _, value in self._pairs(node):
            table[name] = self._plain(value)
        return table

    def _pairs(self, table: Any) -> Iterator[tuple[str, yaml.Node, Any]]:
        """Return the texts of a table's keys with the nodes of keys and values."""
        seen: set[str] = set()
        for key, value in table.value:
            if not isinstance(key, yaml.ScalarNode):
                raise self._error_at(TEXT_RIGHT, key.start_mark)
            if key.value in seen:
                raise self._error_at(f"{key.value} stands here twice", key.start_mark)
            seen.add(key.value)
            yield key.value, key, value

    def _refuse_deep(self, text: str) -> None:
        """Refuse a text that nests deeper than any such file: the composer recurses, in C too."""
        depth = 0
        for event in yaml.parse(_Stream(text, self._file), Loader=LOADER):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                message = f"lists and tables nest more than {DEEPEST} deep here"
                raise self._error_at(message, event.start_mark)


def data_text(folder: str, file: str, read_file: ReadFile | None) -> str:
    """Return the text of a data file; without `read_file` of the one in this package.

    Raises:
        OSError, KeyError: There is none.
    """
    if read_file is not None:
        return read_file(file)
    return (resources.files(__package__) / folder / file).read_text(encoding="utf-8")


def open_data_file(folder: str, name: str, read_file: ReadFile | None) -> YamlFile:
    """Open a data file of `folder` by its name without `.yaml`.

    Raises:
        DescriptionError: It is missing, or no YAML.
    """
    file = f"{name}.yaml"
    try:
        text = data_text(folder, file, read_file)
    except (OSError, KeyError) as exc:
        raise DescriptionError("there is no such data file", file=f"{folder}/{file}") from exc
    return YamlFile(text, f"{folder}/{file}", family=name)


class _Stream(io.StringIO):
    """A text whose nodes know the name of their file."""

    def __init__(self, text: str, name: str) -> None:
        super().__init__(text)
        self.name = name


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


def _order(mark: Any) -> tuple[int, int]:
    return mark.line, mark.column


def _path(error: ErrorDetails) -> Path:
    """Return the path of the wrong value, of a key that is not known the key's."""
    path = error["loc"] + tuple(error.get("ctx", {}).get("below", ()))
    return (*path, KEY) if error["type"] == "unexpected_keyword_argument" else path


def _message(error: ErrorDetails, kind: type) -> str:
    """Say in plain words what is wrong and what would be right."""
    *above, last = error["loc"]
    if error["type"] == "missing":  # also one of a pair, whose key is then missing
        return f"{above[-1] if isinstance(last, int) else last} is missing"
    if error["type"] == "unexpected_keyword_argument":
        return f"{last} is not known here; {', '.join(sorted(_keys(kind, above)))} are"
    if error["type"] in ("enum", "literal_error"):
        expected = error["ctx"]["expected"].replace(" or ", ", ").replace("'", "")
        return f"{error['input']} is not known here; {expected} are"
    return MESSAGES.get(error["type"], error["msg"])


def _keys(kind: Any, path: list[int | str]) -> dict[str, Any]:
    """Return the keys of the table at a path, with their types."""
    for step in (*path, None):
        known: dict[str, Any] = {}
        for name, hint in get_type_hints(kind, include_extras=True).items():
            marks = getattr(hint, "__metadata__", ())
            aliases = [one.validation_alias for one in marks if isinstance(one, FieldInfo)]
            alias = aliases[0] if aliases else name
            if NOT_A_KEY not in marks:
                known[str(alias.path[0] if isinstance(alias, AliasPath) else alias)] = hint
        kind = _table_in(known.get(str(step))) or kind
    return known


def _table_in(kind: Any) -> Any:
    """Return the dataclass that a type's tables are read into; None where it has none."""
    if is_dataclass(kind):
        return kind
    marks = getattr(kind, "__metadata__", ())
    forms = [mark.form for mark in marks if isinstance(mark, ReadAs)]
    inner = forms or (get_args(kind)[:1] if marks else get_args(kind))
    return next((found for one in inner if (found := _table_in(one))), None)
