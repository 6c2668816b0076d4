"""Model predictive control: condensed quadratic programs, their solver, and what is applied when one is not solved."""
