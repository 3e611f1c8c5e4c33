"""The published datasets, a class each, as :mod:`eldata.datasets` has them."""
