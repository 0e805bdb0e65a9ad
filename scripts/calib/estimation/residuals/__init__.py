"""Residuals: one file per kind of measurement, listed in residual_registry.

assignment     what every kind returns: features, residuals, weights
robust_loss    Tukey's biweight: weight and cost
nearest_point  kinds that are compared with points of the target: template_point, template_vertex
"""
