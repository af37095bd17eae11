"""The polynomial methods, the transfer matrix of many channels and the choice of orders."""
