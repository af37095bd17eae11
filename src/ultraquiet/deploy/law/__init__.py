"""What is deployed: the realisation of a law, its coefficients, its anti-windup and its twin."""
