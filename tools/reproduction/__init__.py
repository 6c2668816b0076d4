"""The paper's figures and tables, measured again: `tools/reproduce` runs these, one file a figure or table."""
