"""Noise calibration: frames -> sums over frames -> estimators -> findings -> results.

``frames`` sorts and reads them, one at a time; ``defects``, ``bias_sums`` and ``flats`` sum them up. Estimators:
``defects`` (what stays), ``bias_sums`` (row noise, colour bias), ``residuals`` (read noise) and ``flats`` (K).
``checks`` finds the assumptions that do not hold. ``iso_results`` holds an ISO's figures and findings, ``joint`` fits
lines over K, ``results`` holds a camera's. ``one_iso`` and ``camera`` run it all. The public names load on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
