"""What a record leaves open of the response of a model that was identified from it."""
