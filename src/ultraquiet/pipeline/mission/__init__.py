"""What laws are for: the payload that they keep quiet, the benches they must work on, how they come on."""
