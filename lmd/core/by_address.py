"""How numba hands over large named tuples: by their address, of which a function reads what it needs.

With its own model every function takes, and hands on, each of hundreds of numbers of a field, a state and a scratch:
most of what is compiled. A named tuple never changes, so whoever makes one lays it down once for all whom it calls. A
function reads members where it begins: there they are found once, and not anew in loops.

Only `lmd.core.inside_numba` uses this.
"""

from collections import Counter
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.analysis import compute_use_defs, must_use_alloca
from numba.core.datamodel.models import TupleModel
from numba.core.datamodel.registry import default_manager
from numba.core.ir import Assign
from numba.core.lowering import Lower

LARGE = 40  # arguments that a named tuple would be from which on it goes by its address


class _ByAddress(TupleModel):
    """A large named tuple; of values, those that lie at an `address` have one, and `members` that were read of it."""

    def get_argument_type(self) -> Any:
        """A pointer."""
        return self.get_value_type().as_pointer()

    def as_argument(self, builder: Any, value: Any) -> Any:
        """Where the value lies."""
        if not hasattr(value, "address"):
            value.address = _laid_down(builder, value)
        return value.address

    def from_argument(self, builder: Any, address: Any) -> Any:
        """What lies there, which nobody writes to meanwhile."""
        address.add_attribute("noalias")
        address.add_attribute("captures(none)")
        return _lying_at(address, builder.load(address))

    def as_return(self, builder: Any, value: Any) -> Any:
        """The value."""
        return value if self._is_kept_as_it_is else super().as_return(builder, value)

    def from_return(self, builder: Any, value: Any) -> Any:
        """What a function left where it was told to, which is there until it is called there again."""
        if self._is_kept_as_it_is and isinstance(value, ir.LoadInstr):
            return _lying_at(value.operands[0], value)
        return super().from_return(builder, value)

    @property
    def _is_kept_as_it_is(self) -> bool:
        """Whether nothing in it is another type in memory, as truth values are."""
        return bool(self.get_data_type() == self.get_value_type())


def _lying_at(address: Any, value: Any) -> Any:
    """A value that was read from an address, of which only the members that are asked for need be."""
    value.address, value.members = address, {}
    return value


def _model_of(manager: Any, kind: Any) -> Any:
    """How a named tuple is handed over: as numba does, but for large ones of this package."""
    model = TupleModel(manager, kind)
    own = kind.instance_class.__module__.partition(".")[0] == "lmd"
    # One that has another which goes by its address would be laid down anew for each call, if it went by its members.
    large = _width(model.get_argument_type()) >= LARGE or any(_has_large(manager, each) for each in kind.types)
    return _ByAddress(manager, kind) if own and large else model


def _has_large(manager: Any, kind: Any) -> bool:
    """Whether values of a type, or some of their members, go by their address."""
    return isinstance(manager.lookup(kind), _ByAddress) or any(
        _has_large(manager, each) for each in getattr(kind, "types", ())
    )


def _width(kinds: Any) -> int:
    """How many arguments a tuple of tuples of types is."""
    return sum(map(_width, kinds)) if isinstance(kinds, tuple) else 1


def _laid_down(builder: Any, value: Any) -> Any:
    """The address of a value that is laid down as soon as there is one."""
    entry = builder.function.entry_basic_block
    with builder.goto_entry_block():
        address = builder.alloca(value.type)
        if not isinstance(value, ir.Instruction) or value.parent is entry:
            builder.store(value, address)
            return address
    _behind(builder, value, lambda after: after.store(value, address))
    return address


def _behind(builder: Any, instruction: Any, write: Callable[[Any], Any]) -> Any:
    """What `write` returns, which writes instructions behind another one, wherever the builder is."""
    after = ir.IRBuilder()
    after.position_after(instruction)
    place = after._anchor
    written = write(after)
    if builder._block is after._block and builder._anchor >= place:
        builder._anchor += after._anchor - place
    return written


def _extract(builder: Any, value: Any, number: Any, name: str = "", extract: Any = ir.IRBuilder.extract_value) -> Any:
    """A member of an aggregate: as `extract` does, but of what lies at an address only the member is read."""
    members = getattr(value, "members", None)
    if members is None:
        return extract(builder, value, number, name)
    (index,) = number if isinstance(number, list | tuple) else (number,)
    if index not in members:

        def read(after: Any) -> Any:
            address = after.gep(value.address, [ir.IntType(32)(0), ir.IntType(32)(index)], inbounds=True)
            member = after.load(address)
            return _lying_at(address, member) if isinstance(member.type, ir.LiteralStructType) else member

        members[index] = _behind(builder, value, read)
    return members[index]


def _find_values(lower: Any, find: Any = Lower._find_singly_assigned_variable) -> None:
    """Find variables that are values and need no place: as numba does, and those that have one from the beginning on.

    numba takes only those that are used where they are assigned, and copies all others for every use. Where it counts
    who holds arrays, variables end more than once.
    """
    find(lower)
    if lower.context.enable_nrt or lower.func_ir.func_id.is_generator:
        return
    blocks, first = lower.func_ir.blocks, min(lower.func_ir.blocks)
    times = Counter(one.target.name for block in blocks.values() for one in block.find_insts(Assign))
    assigned = {one.target.name for one in blocks[first].find_insts(Assign)}
    once = {name for name in assigned if times[name] == 1}
    lower._singly_assigned_vars |= once - compute_use_defs(blocks).usemap[first] - set(must_use_alloca(blocks))


default_manager.register(types.NamedTuple, _model_of)
ir.IRBuilder.extract_value = _extract
Lower._find_singly_assigned_variable = _find_values  # type: ignore[method-assign]
