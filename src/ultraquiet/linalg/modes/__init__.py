"""Transfer matrices as sums of modes whose residues have rank one: fitted, refined, and the faintest taken out."""
