"""The solvers: matching, Levenberg-Marquardt, and the search from many starts."""
