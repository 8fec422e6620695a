"""
Machine code is made once, of an entry with all that it calls.

Numba optimises every function together with all that it calls and makes machine code of it, again
at every level up to an entry, which inlines all of it and optimises it once more. Here a part,
which only compiled functions call, is translated and simplified alone; an entry is linked from all
parts below it, each once.
"""

import copy
from typing import Any

from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.compiler import Compiler


class PartLibrary(JITCodeLibrary):
    """Code of a part, to be linked."""

    @property
    def codegen(self):
        """Numba's own, but that nothing is put where there is no machine code."""
        own: Any = copy.copy(self._codegen)
        own.set_env = lambda name, environment: None
        return own

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
        found: dict[CodeLibrary, None] = {}
        for library in self._linking_libraries:
            _gather(library, found)
        self._linking_libraries = [*found][::-1]
        super().finalize()


def _gather(library, found):
    """Add a library to those found, behind all that it links."""
    if library in found:
        return
    if isinstance(library, PartLibrary):
        for below in library._linking_libraries:
            _gather(below, found)
    found[library] = None


class PartCompiler(Compiler):
    """Translates a function that only compiled functions call."""

    library: type[JITCodeLibrary] = PartLibrary

    def define_pipelines(self):
        """Give what is compiled its library before numba makes one of its own."""
        state = self.state
        if state.library is None:
            codegen = state.targetctx.codegen()
            state.library = self.library(codegen, state.func_id.func_qualname)
            state.library.enable_object_caching()
        return super().define_pipelines()


class EntryCompiler(PartCompiler):
    """Compiles a function that Python calls, or that is called by its address."""

    library = EntryLibrary
