"""Traffic of stochastic drivers on the roads of highway-env (the extra `simulator`), for `predictor.recorder`.

highway-env counts y downwards; here its scenes are mirrored, so that traffic keeps to the right.
"""
