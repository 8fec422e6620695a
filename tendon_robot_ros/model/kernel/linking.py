"""
How machine code is generated: once, for an entry with all that it calls; records in memory.

Numba optimises every function together with all that it calls and makes machine code of it, again
at every level up to an entry, which inlines all of it and optimises it once more. Here a part,
which only compiled functions call, is translated and simplified alone; an entry is linked from all
parts below it, each once.

A named tuple is passed field by field, and unpacked and packed at every call: of the code of the
kernel that was the larger part. A record is one: its fields lie in memory, an address is passed.
"""

import copy
from typing import Any

from numba.core import cgutils, types
from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.datamodel import models
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, register_model

_RECORDS: dict[str, Any] = {}  # of every type of record: its fields, and their types by name


class PartLibrary(JITCodeLibrary):
    """Code of a part, to be linked."""

    @property
    def codegen(self):
        """Numba's own, but that nothing is put where there is no machine code."""
        own: Any = copy.copy(self._codegen)
        own.set_env = lambda name, environment: None
        return own

    def _optimize_functions(self, ll_module):
        """Simplify what is to be linked a little."""
        ll_module.data_layout = self._codegen._data_layout
        for function in ll_module.functions:
            if not function.is_declaration:
                passes, builder = self._codegen._function_pass_manager(opt=1)
                passes.run(function, builder)

    def finalize(self):
        """Leave linking, optimisation of the whole and machine code to the entry."""
        self._finalized = True

    def get_pointer_to_function(self, name):
        """Return 0: there is no machine code."""
        return 0


class EntryLibrary(JITCodeLibrary):
    """Machine code of an entry with all parts below it."""

    def finalize(self):
        """
        Link what the parts call as well, then optimise.

        Callers before what they call: of a module that is linked, LLVM takes what is asked for.
        """
        libraries: dict[CodeLibrary, None] = {}
        for library in self._linking_libraries:
            _gather(library, libraries)
        self._linking_libraries = [*libraries][::-1]
        super().finalize()

    def _optimize_final_module(self):
        """Optimise the whole once: there are hardly any reference counts to look for before."""
        passes, builder = self._codegen._module_pass_manager(opt=2)
        passes.run(self._final_module, builder)


def _gather(library, libraries):
    """Append a library to `libraries`, behind all that it links."""
    if library in libraries:
        return
    if isinstance(library, PartLibrary):
        for below in library._linking_libraries:
            _gather(below, libraries)
    libraries[library] = None


class PartCompiler(Compiler):
    """Translates a function that only compiled functions call."""

    library: type[JITCodeLibrary] = PartLibrary

    def define_pipelines(self):
        """Set the library of the code before numba creates one of its own."""
        state = self.state
        if state.library is None:
            codegen = state.targetctx.codegen()
            state.library = self.library(codegen, state.func_id.func_qualname)
            state.library.enable_object_caching()
        return super().define_pipelines()


class EntryCompiler(PartCompiler):
    """Compiles a function that Python calls, or that is called by its address."""

    library = EntryLibrary


class RecordType(types.Type):
    """
    Fields at an address that do not change while compiled code runs, and some apart from it.

    Attributes
    ----------
    apart : tuple of str
        Fields (int64) that are passed beside the address: they may differ.

    """

    def __init__(self, name, apart):
        """Name it; `at` becomes its address."""
        self.apart = apart
        super().__init__(name)


@register_model(RecordType)
class RecordModel(models.StructModel):
    """An address, and the fields apart."""

    def __init__(self, manager, kind):
        """Define the members that are passed."""
        members = [(name, types.int64) for name in ('at', *kind.apart)]
        super().__init__(manager, kind, members)


@infer_getattr
class RecordFields(AttributeTemplate):
    """Types of the fields."""

    key = RecordType

    def generic_resolve(self, kind, name):  # type: ignore[override]
        """Return the type of a field."""
        return types.int64 if name == 'at' else _RECORDS[kind.name][1][name]


@lower_getattr_generic(RecordType)
def get_field(context, builder, kind, value, name):
    """Load a field, a function by its address; LLVM may load it once."""
    record = cgutils.create_struct_proxy(kind)(context, builder, value=value)
    if name == 'at' or name in kind.apart:
        return getattr(record, name)
    fields, kinds = _RECORDS[kind.name]
    item, calls = kinds[name], isinstance(kinds[name], types.FunctionType)
    place = types.CPointer(types.int64 if calls else item)
    start = builder.inttoptr(record.at, context.get_value_type(place))
    loaded = builder.load(cgutils.gep_inbounds(builder, start, fields.index(name)))
    loaded.set_metadata('invariant.load', builder.module.add_metadata([]))
    if not calls:
        return loaded
    function = cgutils.create_struct_proxy(item)(context, builder)
    function.c_addr = function.jit_addr = builder.inttoptr(loaded, cgutils.voidptr_t)
    function.py_addr = cgutils.get_null_value(function.py_addr.type)
    return function._getvalue()


def record_type(fields, kinds, apart=()):
    """
    Return the type of records with the fields of a named tuple, and what makes one of them.

    `kinds` holds the type of every field, and may change until code is compiled. The maker is for
    compiled code, and takes the address and the fields apart.
    """
    kind = RecordType(fields.__name__, apart)
    _RECORDS[kind.name] = fields._fields, kinds

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
