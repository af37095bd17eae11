"""A law comes on in steps, S and the margins measured at each from injections, without a model."""
