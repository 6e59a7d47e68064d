"""The sensor as a parametric design: parameters, checks, optics, parts, drawings, twin.

Figures and checks need nothing beyond the plain install; solids and drawings need the extra
``[design]``.
"""
