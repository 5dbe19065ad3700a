from .snakeboard.board import TABLE_II as TABLE_II
from .snakeboard.board import Board as Board
from .snakeboard.paper_constraints import Coupled as Coupled
from .snakeboard.paper_constraints import Printed as Printed
from .snakeboard.paper_examples import Preset as Preset
from .snakeboard.paper_examples import preset as preset
