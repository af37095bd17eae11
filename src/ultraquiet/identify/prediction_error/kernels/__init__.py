"""The compiled loops of the prediction-error engine: filters, normal equations, steps of the table."""
