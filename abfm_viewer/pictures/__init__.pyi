from .document_pictures import DocumentRenderer as DocumentRenderer
from .document_pictures import PictureOptions as PictureOptions
from .movies import write_movie as write_movie
from .sheets.figure_picture import figure_picture as figure_picture
from .sheets.match_picture import match_picture as match_picture
from .sheets.plot_pictures import plot_picture as plot_picture
from .sheets.ranges import captions as captions
