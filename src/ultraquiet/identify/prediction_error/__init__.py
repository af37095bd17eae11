"""The prediction-error engine: parameterisation, initial models, search, records on disk."""
