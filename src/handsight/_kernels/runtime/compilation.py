"""How kernels are compiled: `inner` ones for other kernels, `entry` ones for Python.

By default numba optimises every function together with all its callees, and generates machine code for it, at each
level of the call tree. An entry inlines and optimises all its callees anyway. Inner functions are therefore only
lowered to LLVM code and linked, which saves a third of the compile time.
"""

import sys
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any, TypeVar

import numba
from numba import _dynfunc
from numba.core import codegen, lowering, typed_passes
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass

# Numba asks once whether SciPy's BLAS can be imported, which no kernel of handsight calls; loading it takes a third of
# the time to the first correction. An empty module takes its place during that check; later imports get SciPy's own.
if "numba.np.arraymath" not in sys.modules and "scipy.linalg.cython_blas" not in sys.modules:
    sys.modules["scipy.linalg.cython_blas"] = ModuleType("scipy.linalg.cython_blas")
    try:
        import_module("numba.np.arraymath")
    finally:
        del sys.modules["scipy.linalg.cython_blas"]

from handsight._kernels.runtime.kernel_cache import KernelCache

F = TypeVar("F", bound=Callable[..., Any])

FAST = {"contract", "nsz", "reassoc"}
"""What the compiler may do to floating point: sum in another order, ignore the sign of zero; NaN and infinity stay."""


def inner(function: F) -> F:
    """Returns a function for other kernels: compiled into each of them, and not callable from Python."""
    return numba.njit(
        error_model="numpy",
        fastmath=FAST,
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
        pipeline_class=_LinkOnlyCompiler,
    )(function)


def entry(function: F) -> F:
    """Returns a kernel that Python calls; its machine code is kept on disk, and it releases the interpreter."""
    dispatcher = numba.njit(error_model="numpy", fastmath=FAST, nogil=True)(function)
    dispatcher._cache = KernelCache(function)
    return dispatcher


class _LinkOnlyLibrary(codegen.JITCodeLibrary):  # type: ignore[misc]
    """A `_LinkOnlyLibrary` is code to be linked into others, neither optimised by itself nor made machine code."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _LinkOnlyLowering(typed_passes.BaseNativeLowering):  # type: ignore[misc]
    """`_LinkOnlyLowering` replaces the last of numba's passes, and lowers into a `_LinkOnlyLibrary`."""

    _name = "lowering_to_link"

    @property
    def lowering_class(self) -> Any:
        return lowering.Lower

    def run_pass(self, state: Any) -> bool:
        """Lowers the function, and registers it for its callers by a function object without machine code."""
        context, function = state.targetctx, state.func_id
        state.library = _LinkOnlyLibrary(context.codegen(), function.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        state.library.finalize()
        described = state.cr.fndesc
        key = _dynfunc.make_function(
            described.lookup_module(), function.func_name, "", 0, state.cr.env, (state.library,)
        )
        context.insert_user_function(key, described, [state.library])
        state.cr = state.cr._replace(cfunc=key)
        return True


class _LinkOnlyCompiler(CompilerBase):  # type: ignore[misc]
    """A `_LinkOnlyCompiler` runs numba's passes, the last of them replaced."""

    def define_pipelines(self) -> list[Any]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes[:] = [
            (_LinkOnlyLowering if step is typed_passes.NativeLowering else step, text)
            for step, text in passes.passes
        ]
        passes.finalize()
        return [passes]
