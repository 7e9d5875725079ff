from .path_files import path_from_csv as path_from_csv
from .sweeps import sweep as sweep
from .sweeps import write_table as write_table
from .trial import Trial as Trial
from .trial import trials as trials
