"""The nonlinear program: residuals of a group linearized to a factor (measurement_factor), the
joint problem of all factors (joint_nlp), its sparse Hessian (nlp_hessian) and IPOPT
(ipopt_solver), and covariances from information matrices (information_matrix)."""
