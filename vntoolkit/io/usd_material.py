"""A matte material that shows the vertex colours: without one Blender reads the colours and renders grey."""

from __future__ import annotations

from typing import Any


def add_colour_material(stage: Any, path: str, surface: Any) -> None:
    """Define at `path` a UsdPreviewSurface whose colour is the primvar `displayColor`; bind the surface."""
    from pxr import Sdf, UsdShade

    material = UsdShade.Material.Define(stage, path)
    reader = UsdShade.Shader.Define(stage, f"{path}/Colour")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    shader = UsdShade.Shader.Define(stage, f"{path}/Matte")
    shader.CreateIdAttr("UsdPreviewSurface")
    colour = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    colour.ConnectToSource(reader.CreateOutput("result", Sdf.ValueTypeNames.Float3))
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(1.0)
    shown = shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(shown)
    UsdShade.MaterialBindingAPI.Apply(surface.GetPrim()).Bind(material)
