"""The flow as workflows (data only), so that `hrt init` can copy them out of a wheel."""
