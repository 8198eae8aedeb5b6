"""The court: plants with withheld effects, sealed answers, scores."""
