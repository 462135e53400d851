"""Grids and surfaces in VTK's XML, made in memory: its own writers leave empty files on a full disk, or crash."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyvista as pv

VTK_POLY_DATA = 0  #: VTK's number of surfaces among its kinds of data


def vtk_content(grid: "pv.DataSet") -> bytes:
    """Content of the VTU file of a grid or the VTP file of a surface."""
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    is_surface = grid.GetDataObjectType() == VTK_POLY_DATA
    writer = vtkXMLPolyDataWriter() if is_surface else vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetWriteToOutputString(True)
    if not writer.Write():
        raise MemoryError
    return writer.GetOutputString().encode()
