"""The nonlinear program: measurements condensed to factors, the joint problem for IPOPT, and
information matrices."""
