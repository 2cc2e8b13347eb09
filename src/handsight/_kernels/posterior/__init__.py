"""The posterior around a mode: information, covariance, mean, and its propagation over time."""
