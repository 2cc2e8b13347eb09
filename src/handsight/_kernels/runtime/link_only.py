"""How numba compiles a function that kernels call and nobody else: to what a kernel links, and no further.

By itself numba optimises such a function and makes machine code of it, with all that it calls, once for each level of
calls above it. Left to the kernel, which inlines all of it anyway, that is done once, and a third of the time is saved.
"""

from typing import Any

from numba import _dynfunc
from numba.core import codegen, compiler, lowering, typed_passes
from numba.core.compiler_machinery import register_pass


class _Library(codegen.JITCodeLibrary):  # type: ignore[misc]
    """A `_Library` is code to be linked: neither optimised as a whole nor given to the machine."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(typed_passes.BaseNativeLowering):  # type: ignore[misc]
    """`_Lowering` is numba's last pass, into such a library."""

    _name = "lowering_to_link"

    @property
    def lowering_class(self) -> Any:
        return lowering.Lower

    def run_pass(self, state: Any) -> bool:
        """Runs as numba's, but for the library and for what stands for the function's machine code, which must be
        unique."""
        context, function = state.targetctx, state.func_id
        state.library = _Library(context.codegen(), function.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        state.library.finalize()
        described, kept_alive = state.cr.fndesc, (state.library,)
        key = _dynfunc.make_function(
            described.lookup_module(), function.func_name, "", 0, state.cr.env, kept_alive
        )
        context.insert_user_function(key, described, [state.library])
        state.cr = state.cr._replace(cfunc=key)
        return True


class Linked(compiler.CompilerBase):  # type: ignore[misc]
    """`Linked` is numba's passes with that one at their end."""

    def define_pipelines(self) -> list[Any]:
        passes = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        steps = [
            (_Lowering, text) if step is typed_passes.NativeLowering else (step, text)
            for step, text in passes.passes
        ]
        passes.passes[:] = steps
        passes.finalize()
        return [passes]
