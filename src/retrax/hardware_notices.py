"""Notices of JAX about hardware that its installation does not use, left out of the log."""

import logging

NOTICE = "is not installed. Falling back to"  # in the notices about GPUs and TPUs without their jaxlib
LOGGER = "jax._src.xla_bridge"  # of the notices


def is_wanted(record: logging.LogRecord) -> bool:
    """Whether a line of the log of JAX is anything but a notice about hardware: retrax solves on the CPU."""
    return NOTICE not in record.getMessage()


def leave_out() -> None:
    """Leave the notices out of the log; a second call changes nothing."""
    logging.getLogger(LOGGER).addFilter(is_wanted)
