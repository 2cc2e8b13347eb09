"""What several experiments share: simulated trials, methods and their errors."""
