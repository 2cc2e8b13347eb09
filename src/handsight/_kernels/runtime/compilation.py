"""How kernels are compiled: `inner` ones for other kernels, `entry` ones for Python.

By default numba optimises every function together with all its callees, and generates machine code for it, at each
level of the call tree. An entry inlines and optimises all its callees anyway. Inner functions are therefore only
lowered to LLVM code and linked, and an entry is optimised once, which saves half of the compile time.
"""

import gc
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from types import ModuleType
from typing import Any, TypeVar

import numba
import numpy as np
from llvmlite.binding import create_pass_builder, create_pipeline_tuning_options, parse_assembly
from numba import _dynfunc, types
from numba.core import codegen, compiler, ir, typed_passes
from numba.core.compiler_machinery import register_pass
from numba.core.itanium_mangler import mangle

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
    return _jit(no_cpython_wrapper=True)(function)


def entry(function: F) -> F:
    """Returns a kernel that Python calls; its machine code is kept on disk, and it releases the interpreter.

    Other kernels cannot call it. It is compiled for arrays that are contiguous and can be written to: of other ones it
    gets copies, and those that can be written to are filled from these, because compiling it for each layout would
    take half a minute where a caller does not expect it.
    """
    dispatcher = _jit(nogil=True)(function)
    dispatcher._cache = KernelCache(function)
    compile_for = dispatcher._compile_for_args

    def called(*arguments: Any) -> Any:
        usual = [np.require(a, None, ["C", "A", "W"]) if isinstance(a, np.ndarray) else a for a in arguments]
        result = dispatcher(*usual)
        for array, copy in zip(arguments, usual, strict=True):
            if array is not copy and array.flags.writeable:
                array[...] = copy
        return result

    def callable_for(*arguments: Any) -> Any:
        """Returns, for numba, what is to be called with arguments that no compiled code fits."""
        arrays = [a.flags for a in arguments if isinstance(a, np.ndarray)]
        return compile_for(*arguments) if all(f.carray for f in arrays) else called

    dispatcher._compile_for_args = callable_for
    return dispatcher


class _InnerLibrary(codegen.JITCodeLibrary):  # type: ignore[misc]
    """An `_InnerLibrary` is code to be linked into entries, neither optimised by itself nor made machine code."""

    def add_llvm_module(self, ll_module: Any) -> None:
        """Takes the code as it is; entries link what it calls, too."""
        self._final_module = self._shared_module = ll_module
        self._finalized = True


class _EntryLibrary(codegen.JITCodeLibrary):  # type: ignore[misc]
    """An `_EntryLibrary` is machine code of an entry and of all that it calls; no other kernel can call it."""

    def _optimize_final_module(self) -> None:
        """Optimises; inner functions are the entry's own, so that LLVM may change what they take, or do without them.

        Were they not, LLVM would call one of the same name in another entry instead. Where that was compiled in
        another process, the numbers in the name can stand for other types. Loops stay loops: most have few rounds, and
        unrolled ones are a third of the machine code.
        """
        for library in self._linking_libraries:
            if isinstance(library, _InnerLibrary):
                for function in library.get_defined_functions():
                    self._final_module.get_function(function.name).linkage = "internal"
        tuning = create_pipeline_tuning_options(speed_level=3)
        tuning.loop_unrolling = tuning.loop_vectorization = tuning.slp_vectorization = False
        builder = create_pass_builder(self._codegen._tm, tuning)
        passes = builder.getModulePassManager()
        passes.add_refprune_pass()
        passes.run(self._final_module, builder)

    def serialize_using_object_code(self) -> Any:
        """Returns what is kept on disk: machine code, and the names that it defines instead of code for callers."""
        name, kind, (machine_code, _) = super().serialize_using_object_code()
        defined = (f'@"{function.name}" = global i8 0' for function in self.get_defined_functions())
        return name, kind, (machine_code, parse_assembly("\n".join(defined)).as_bitcode())


def _owns_arrays(state: Any) -> bool:
    """Whether a function makes, copies or returns arrays, or gets them from others; else it need not count references.

    What is read out of something is a view of it.
    """
    views = {"build_tuple", "cast", "exhaust_iter", "getattr", "getitem", "phi", "static_getitem"}
    owned, type_of = [state.return_type], state.typemap
    for step in (step for block in state.func_ir.blocks.values() for step in block.body):
        if isinstance(step, ir.SetItem | ir.StaticSetItem):
            owned.append(type_of[step.value.name])
        elif isinstance(step, ir.Assign) and getattr(step.value, "op", "cast") not in views:
            owned.append(type_of[step.target.name])
    return any(state.targetctx.data_model_manager[kind].contains_nrt_meminfo() for kind in owned)


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(typed_passes.NativeLowering):  # type: ignore[misc]
    """`_Lowering` replaces the last of numba's passes, and lowers into an `_InnerLibrary` or an `_EntryLibrary`."""

    _name = "lowering_to_link"

    def run_pass(self, state: Any) -> bool:
        """Lowers the function, and registers an inner one for its callers by a function object without machine code."""
        context, function, inner = state.targetctx, state.func_id, state.flags.no_cpython_wrapper
        if inner:
            context = state.targetctx = context.subtarget(enable_nrt=_owns_arrays(state))
            # Numba's names tell all fields of records, in hundreds of letters.
            context.mangler = lambda name, types, *, uid, **_: mangle(name, (), uid=hash((uid, types)))
        library = (_InnerLibrary if inner else _EntryLibrary)(context.codegen(), function.func_qualname)
        library.enable_object_caching()
        state.library, state.flags.no_compile = library, inner
        super().run_pass(state)
        if inner:
            described, environment = state.cr.fndesc, state.cr.env
            module, name = described.lookup_module(), function.func_name
            key = _dynfunc.make_function(module, name, "", 0, environment, (library,))
            context.insert_user_function(
                key, described, [*dict.fromkeys([library, *library._linking_libraries])]
            )
            state.cr = state.cr._replace(cfunc=key)
        return True


_call_types: dict[Any, Any] = {}


def _call_type(function: Any, context: Any, args: Any, kws: Any) -> Any:
    """Returns the types of a call of a function or operator of numba's, which takes numba long, once for each."""
    key = function, tuple(args), tuple(kws.items())
    if key not in _call_types:
        _call_types[key] = _resolved(function, context, args, kws)
    return _call_types[key]


_resolved = types.BaseFunction.get_call_type


class _Compiler(compiler.CompilerBase):  # type: ignore[misc]
    """A `_Compiler` runs numba's passes, the last of them replaced."""

    def compile_extra(self, function: Any) -> Any:
        """Compiles a function while the garbage collector rests, which would take a sixth of the time."""
        collects, resolve = gc.isenabled(), types.BaseFunction.get_call_type
        gc.disable()
        types.BaseFunction.get_call_type = _call_type
        try:
            return super().compile_extra(function)
        finally:
            types.BaseFunction.get_call_type = resolve
            if collects:
                gc.enable()

    def define_pipelines(self) -> list[Any]:
        # What is left out is for closures, functions of other packages, and arithmetic of whole arrays.
        unused = {"InlineClosureLikes", "InlineOverloads", "NopythonRewrites"}
        passes = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes[:] = [
            (_Lowering if step is typed_passes.NativeLowering else step, text)
            for step, text in passes.passes
            if step.__name__ not in unused
        ]
        passes.finalize()
        return [passes]


_jit = partial(
    numba.njit, error_model="numpy", fastmath=FAST, no_cfunc_wrapper=True, pipeline_class=_Compiler
)
