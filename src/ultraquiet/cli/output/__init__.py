"""What commands share in what they print: options, tables, JSON, figures."""
