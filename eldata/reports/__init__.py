"""Reports: diagnostics as plain numbers, plots of them, and pages that need no network."""
