"""The evidence terms: residual rows of each kind of measurement and their derivatives."""
