from .replay import write_replay as write_replay
from .scene import Scene as Scene
from .viewer import Viewer as Viewer
from .viewer import write_html as write_html
