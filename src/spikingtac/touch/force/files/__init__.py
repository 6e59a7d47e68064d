"""Files of force estimation: labels, series and fitted models."""
