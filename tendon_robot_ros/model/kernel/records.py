"""
Named tuples of words that lie in memory: compiled functions pass an address, not the fields.

Numba passes a named tuple field by field, and unpacks and packs all of them at every call: of the
code of the kernel that was the larger part, to be translated and optimised.
"""

from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, register_model


class RecordType(types.Type):
    """
    Fields at an address that do not change while compiled code runs, and some apart from it.

    Attributes
    ----------
    places : dict
        Place and type of every field.
    apart : tuple of str
        Fields (int64) that are passed beside the address: they may differ.

    """

    def __init__(self, name, places, apart):
        """Name it; `at` becomes its address."""
        self.places, self.apart = places, apart
        super().__init__(name)


@register_model(RecordType)
class RecordModel(models.StructModel):
    """An address, and the fields apart."""

    def __init__(self, manager, kind):
        """Say what is passed."""
        members = [(name, types.int64) for name in ('at', *kind.apart)]
        super().__init__(manager, kind, members)


@infer_getattr
class RecordFields(AttributeTemplate):
    """Types of the fields."""

    key = RecordType

    def generic_resolve(self, kind, name):  # type: ignore[override]
        """Return the type of a field."""
        return types.int64 if name == 'at' else kind.places[name][1]


@lower_getattr_generic(RecordType)
def get_field(context, builder, kind, value, name):
    """Load a field; LLVM may load it once."""
    record = cgutils.create_struct_proxy(kind)(context, builder, value=value)
    if name == 'at' or name in kind.apart:
        return getattr(record, name)
    place, item = kind.places[name]
    start = builder.inttoptr(record.at, context.get_value_type(types.CPointer(item)))
    loaded = builder.load(cgutils.gep_inbounds(builder, start, place))
    loaded.set_metadata('invariant.load', builder.module.add_metadata([]))
    return loaded


def record_type(fields, kinds, apart=()):
    """
    Return the type of records with the fields of a named tuple, and what makes one of them.

    That is for compiled code, and takes the address and the fields apart.
    """
    places = {name: (place, kinds[place]) for place, name in enumerate(fields._fields)}
    kind = RecordType(fields.__name__, places, apart)

    if apart:

        @intrinsic
        def make(typing_context, at, first, second, third):
            return kind(at, first, second, third), _fill
    else:

        @intrinsic
        def make(typing_context, at):
            return kind(at), _fill

    return kind, make


def _fill(context, builder, signature, values):
    record = cgutils.create_struct_proxy(signature.return_type)(context, builder)
    for name, value in zip(('at', *signature.return_type.apart), values, strict=True):
        setattr(record, name, value)
    return record._getvalue()
