"""Checks of user input: each check raises `InputError` with one sentence that names the value."""

import inspect
import math
import traceback
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from functools import cache, partial
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
Item = TypeVar("Item")

LARGEST = 1e12  # greatest magnitude of a number in input; products of greater numbers may overflow
LARGEST_SEED = 2**128 - 1  # greatest seed, as numpy uses 128 bits
ONE_TURN = 2.0 * math.pi + 0.01  # greatest angle, rad, with a margin for rounding; greater angles are probably degrees
# Greatest length of a message, characters; the middle of a longer message is cut out.
LONGEST = 2000


def printable(text: str) -> str:
    """Text with escapes in place of control and other non-printable characters."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def failure(error: BaseException) -> str:
    """Text about an error in code that is not part of `lmd`: type of the error, its message, and the line of code that
    raised it.
    """
    place = traceback.extract_tb(error.__traceback__)[-1]
    why = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"{why} ({Path(place.filename).name}, line {place.lineno})"


class InputError(ValueError):
    """Error in the user's input.

    Args:
        message: one sentence for the user; non-printable characters are replaced by escapes.
        argument: name of the wrong argument, with which the message begins; None if no argument is wrong.
    """

    def __init__(self, message: str, argument: str | None = None) -> None:
        text = printable(message)
        if len(text) > LONGEST:
            text = f"{text[: LONGEST // 2]} ... {text[-LONGEST // 4 :]}"
        super().__init__(text)
        self.argument = argument

    def within(self, whole: str) -> "InputError":
        """Copy of the error with `<whole>.x` as the name of its argument `x`; the error itself if it names no argument.

        `whole` is the name of the argument of which `x` is a part.
        """
        if self.argument is None:
            return self
        return InputError(f"{whole}.{self}", f"{whole}.{self.argument}")


@contextmanager
def argument_of(whole: str) -> Iterator[None]:
    """Context manager that renames the argument of an `InputError` from its block: `x` becomes `<whole>.x`.

    `whole` is the name of the argument of which `x` is a part.
    """
    try:
        yield
    except InputError as error:
        raise error.within(whole) from None


@contextmanager
def said_of(source: object, argument: str | None = None, known: Container[str | None] = ()) -> Iterator[None]:
    """Context manager that puts `source`, such as a path, before the message of an `InputError` from its block.

    The new error names `argument` as the wrong argument. An error whose argument is in `known` is raised unchanged.
    """
    try:
        yield
    except InputError as error:
        raise error if error.argument in known else InputError(f"{source}: {error}", argument) from None


def real(
    name: str,
    value: Any,
    *,
    above: float | None = None,
    low: float | None = None,
    high: float | None = None,
    infinite: bool = False,
) -> float:
    """Return `value` as a float.

    `above` is an open lower bound; `low` and `high` are closed bounds. Infinity is accepted only with `infinite`.
    Without `high`, the magnitude is at most `LARGEST` = 1e12.

    Raises:
        InputError: `value` is not a number, is NaN, or is out of range.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
        raise InputError(f"{name} must be a number, got {value!r}.", name)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf if value > 0 else -math.inf
    if math.isnan(number) or (math.isinf(number) and not infinite):
        raise InputError(f"{name} must be finite, got {value!r}.", name)
    if above is not None and not number > above:
        raise InputError(f"{name} must be greater than {above:g}, got {value!r}.", name)
    if low is not None and high is not None and not low <= number <= high:
        digits = ".9g" if f"{number:g}" in (f"{low:g}", f"{high:g}") else "g"  # else 1.5708 is not in [0, 1.5708]
        raise InputError(f"{name} must be in [{low:{digits}}, {high:{digits}}], got {value!r}.", name)
    if low is not None and number < low:
        raise InputError(f"{name} must be at least {low:g}, got {value!r}.", name)
    if high is not None and number > high:
        raise InputError(f"{name} must be at most {high:g}, got {value!r}.", name)
    if high is None and LARGEST < abs(number) < math.inf:
        raise InputError(f"{name} must be at most {LARGEST:g} in magnitude, got {value!r}.", name)
    return number


def integer(name: str, value: Any, *, low: int, high: int | None = None) -> int:
    """Return `value` as an int in [low, high]; whole floats such as 1e3 are accepted.

    Without `high`, the greatest accepted number is `LARGEST` = 1e12.

    Raises:
        InputError: `value` is not a whole number or is out of range.
    """
    whole = isinstance(value, int | np.integer) or (isinstance(value, float) and value.is_integer())
    if isinstance(value, bool) or not whole:
        raise InputError(f"{name} must be a whole number, got {value!r}.", name)
    real(name, value, low=low, high=high)
    return int(value)


def seed_number(value: Any) -> int:
    """Return `value` as the seed of a random generator; messages call it `seed`.

    Raises:
        InputError: `value` is not a whole number from 0 to `LARGEST_SEED`.
    """
    return integer("seed", value, low=0, high=LARGEST_SEED)


def boolean(name: str, value: Any) -> bool:
    """Return `value` if it is True or False.

    Raises:
        InputError: `value` is neither True nor False; 0 and 1 are refused, too.
    """
    if not isinstance(value, bool):
        raise InputError(f"{name} must be true or false, got {value!r}.", name)
    return value


def choice(name: str, value: Any, options: Sequence[str]) -> str:
    """Return `value` if it is one of `options`.

    Raises:
        InputError: `value` is not one of `options`.
    """
    if value not in options:
        raise InputError(f"{name} must be one of {', '.join(options)}, got {value!r}.", name)
    return str(value)


def vector(name: str, value: Any, size: int | None, **bounds: Any) -> tuple[float, ...]:
    """Return `value` as a tuple of `size` floats, each checked by `real` with the given `bounds`.

    `size` None allows any length but 0.

    Raises:
        InputError: wrong length, or an entry is not an admissible number.
    """
    wanted = f"{name} must be a list of {'' if size is None else f'{size} '}numbers"
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise InputError(f"{wanted}, got {value!r}.", name)
    entries = list(value)
    if (not entries) if size is None else len(entries) != size:
        raise InputError(f"{wanted}, got {entries!r}.", name)
    return tuple(real(f"{name}[{i}]", entry, **bounds) for i, entry in enumerate(entries))


def span(name: str, value: Any, *, point: bool = True, **bounds: float) -> tuple[float, float]:
    """Return `value` as a range of two floats, checked by `real` with the given `bounds`; `point` allows equal ends.

    Raises:
        InputError: `value` is not a pair of admissible numbers, or the first number exceeds the second number.
    """
    low, high = vector(name, value, 2, **bounds)
    if low > high or (low == high and not point):
        raise InputError(f"{name} must go from the lower to the higher value, got {[low, high]}.", name)
    return low, high


def entries(name: str, value: Any, check: Callable[[str, Any], Item]) -> tuple[Item, ...]:
    """Return the list `value` as a tuple of the results of `check`, which is called for each entry.

    Raises:
        InputError: `value` is not a list, or `check` refuses an entry.
    """
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InputError(f"{name} must be a list, got {value!r}.", name)
    return tuple(check(f"{name}[{i}]", entry) for i, entry in enumerate(value))


def only_keys(name: str, value: Iterable[Any], known: Sequence[str]) -> None:
    """Raise `InputError` if `value`, a mapping or its keys, has a key that is not in `known`."""
    if unknown := [key for key in value if key not in known]:
        raise InputError(f"{name} has an unknown key {unknown[0]!r}; it may have {', '.join(known)}.", name)


def text(name: str, value: Any) -> str:
    """Return `value` if it is a non-empty text; raise `InputError` otherwise."""
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"{name} must be a text, got {value!r}.", name)
    return value


# Types of fields of a `Checked` dataclass.
Finite = Annotated[float, real]
Positive = Annotated[float, partial(real, above=0.0)]
NotNegative = Annotated[float, partial(real, low=0.0)]
Share = Annotated[float, partial(real, low=0.0, high=1.0)]
Count = Annotated[int, partial(integer, low=1)]
Index = Annotated[int, partial(integer, low=0)]
Switch = Annotated[bool, boolean]
Pair = Annotated[tuple[float, ...], partial(vector, size=2)]
Point = Annotated[tuple[float, ...], partial(vector, size=3)]


def bounded(what: str, number: float, most: float, source: str, argument: str | None = None) -> None:
    """Raise `InputError` if a file or a setting requires more than `most` objects; called before the objects are made.

    Args:
        what: plural noun, such as `triangles`.
        number: required number; NaN is refused.
        most: greatest accepted number, far above the numbers in real input.
        source: subject of the message, such as `path: 'room.obj'`.
        argument: name of the argument that is the cause.
    """
    if not number <= most:
        raise InputError(f"{source} has {number:.9g} {what}; at most {most:.9g} are allowed.", argument)


def check_members(name: str, part: Any, protocol: type, page: str) -> None:
    """Raise `InputError` if an object of a user's class lacks a method or property that a protocol requires.

    Args:
        name: name of the argument.
        part: the object.
        protocol: class with the required methods and properties.
        page: page of the documentation that describes the protocol.
    """
    wanted = [member for member in vars(protocol) if not member.startswith("_")]
    # A property may be slow or raise an error, so only members that a static look-up does not find are evaluated.
    absent = [member for member in wanted if inspect.getattr_static(part, member, wanted) is wanted]
    lacking = [member for member in absent if not hasattr(part, member)]
    if lacking:
        kind = f"{type(part).__module__}.{type(part).__qualname__}"
        raise InputError(f"{name} is a {kind}, which lacks {', '.join(lacking)}; see {page}.", name)


def returned(part: Any, method: str, value: Any, *shape: int | None, truth: bool = False) -> Any:
    """Check the result of a method of a user's class, and return this result as an array.

    Args:
        part: object of that class.
        method: name of the method.
        value: result of the method.
        shape: required length of each axis of the result; None for any length.
        truth: True if the result must be a mask of booleans, False if its entries must be real numbers.

    Raises:
        InputError: the result has another shape, or entries of another type.
    """
    array = np.asarray(value)
    fits = len(shape) == array.ndim and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in ("b" if truth else "biuf"):
        wanted = ", ".join("any" if n is None else str(n) for n in shape) + "," * (len(shape) == 1)
        raise InputError(
            f"{type(part).__qualname__}.{method} must be {'booleans' if truth else 'real numbers'} of the shape "
            f"({wanted}), got {array.dtype} of the shape {array.shape}."
        )
    return array


@cache
def _field_checks(kind: type) -> tuple[tuple[str, Callable[[str, Any], Any], bool], ...]:
    """Fields that `Checked` checks in a dataclass: for each, its name, check function, and True if None is allowed."""
    found = []
    for field in fields(kind):
        types = get_args(field.type) if get_origin(field.type) in (Union, UnionType) else (field.type,)
        checks = [each.__metadata__[0] for each in types if get_origin(each) is Annotated]
        found += [(field.name, check, NoneType in types) for check in checks]
    return tuple(found)


class Checked:
    """Base of a frozen dataclass that checks its fields.

    The type of a field names its check: a field of the type `Annotated[T, check]` becomes `check(name, value)`. A field
    of the type `Annotated[T, check] | None` may be None, too. Fields are checked in their order; then `_validate`
    checks the combination of fields.

    >>> @dataclass(frozen=True)
    ... class Lamp(Checked):
    ...     power: Positive
    ...     colour: Annotated[str, partial(choice, options=("red", "white"))] = "white"
    >>> Lamp(power=0)
    Traceback (most recent call last):
    lmd.core.checks.InputError: power must be greater than 0, got 0.
    """

    def __post_init__(self) -> None:
        for name, check, optional in _field_checks(type(self)):  # type: ignore[arg-type] # a type has a hash
            value = getattr(self, name)
            if value is not None or not optional:
                object.__setattr__(self, name, check(name, value))
        self._validate()

    def _validate(self) -> None:
        """Raise `InputError` if fields that are valid one by one are invalid together."""


def file_path(name: str, value: Any) -> Path:
    """Return `value` as a path.

    Raises:
        InputError: `value` is neither a text nor a path.
    """
    if not isinstance(value, str | Path):
        raise InputError(f"{name} must be the path of a file or a folder, got {value!r}.", name)
    return Path(value)
