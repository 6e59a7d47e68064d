"""Public names of live operation."""

# Sensors, followed live
from .live import live as live
from .live import Live as Live
from .live import LiveHealth as LiveHealth
from .live import Hand as Hand
from .sensor import Finger as Finger
from .sensor import LiveFrame as LiveFrame

# The guard of an arm
from .guard import ContactProcess as ContactProcess
from .arrivals import stream_arrivals as stream_arrivals
from .host import Factory as Factory
