"""Public names of live operation."""

# Sensors, followed live
from .live import live as live
from .live import Live as Live
from .live import LiveHealth as LiveHealth
from .live import LiveFrame as LiveFrame

# A camera's events, read at once for several users
from .reader import EventReader as EventReader
from .packets import new_ring as new_ring
from .packets import at_once as at_once
from .packets import RingCamera as RingCamera

# Windows of several sensors in step
from .pair import live_windows as live_windows
