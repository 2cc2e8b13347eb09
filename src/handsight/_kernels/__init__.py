"""What computes, compiled by numba: records and arrays in, results written to arrays. Nothing is checked here.

The rooms check what users give, and call these kernels. Importing numba takes half a second, so rooms that can do
without it import their kernels at the first call.
"""
