"""A project as PLCopen XML (TC6, version 2.01), which CODESYS, TwinCAT and others import.

The code inside is that of the text; declarations are elements, as the schema has them.
"""

from __future__ import annotations

import datetime
import xml.etree.ElementTree as ET
from importlib.metadata import version

from service.codegen.plc import Project
from service.codegen.pou import DataType, Pou, Variable
from service.codegen.st import SCALARS, STORED

NAMESPACE, XHTML = "http://www.plcopen.org/xml/tc6_0201", "http://www.w3.org/1999/xhtml"
_ELEMENTARY = {*SCALARS.values(), *STORED.values(), "LWORD"}
_SECTIONS = {"VAR_INPUT": "inputVars", "VAR_IN_OUT": "inOutVars", "VAR_OUTPUT": "outputVars", "VAR": "localVars"}
_KINDS = {"FUNCTION": "function", "FUNCTION_BLOCK": "functionBlock"}


def as_xml(project: Project) -> str:
    """`project` as a document."""
    ET.register_namespace("", NAMESPACE)
    ET.register_namespace("xhtml", XHTML)
    root = ET.Element(f"{{{NAMESPACE}}}project")
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%S")
    known = {"companyName": "deltatwin", "productName": "deltatwin", "productVersion": version("deltatwin")}
    _in(root, "fileHeader", **known, creationDateTime=now, contentDescription=project.about)
    scale = _in(_in(root, "contentHeader", name=project.name), "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        _in(_in(scale, language), "scaling", x="1", y="1")
    types = _in(root, "types")
    data, pous = _in(types, "dataTypes"), _in(types, "pous")
    for one in project.types:
        _data_type(data, one)
    for pou in project.pous:
        _pou(pous, pou)
    _in(_in(root, "instances"), "configurations")
    ET.indent(root, " ")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _in(parent: ET.Element, tag: str, /, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, f"{{{NAMESPACE}}}{tag}", attributes)


def _data_type(parent: ET.Element, one: DataType) -> None:
    made = _in(parent, "dataType", name=one.name)
    base = _in(made, "baseType")
    if one.array is not None:
        count, element = one.array
        array = _in(base, "array")
        _in(array, "dimension", lower="0", upper=str(count - 1))
        _typed(_in(array, "baseType"), element)
    else:
        _variables(_in(base, "struct"), one.members)
    _documented(made, one.comment)


def _pou(parent: ET.Element, pou: Pou) -> None:
    made = _in(parent, "pou", name=pou.name, pouType=_KINDS[pou.kind])
    interface = _in(made, "interface")
    if pou.returns:
        _typed(_in(interface, "returnType"), pou.returns)
    for word, variables in pou.sections:
        if variables:
            _variables(_in(interface, _SECTIONS[word]), variables)
    text = ET.SubElement(_in(_in(made, "body"), "ST"), f"{{{XHTML}}}p")
    text.text = "\n".join(pou.body)
    _documented(made, pou.comment)


def _variables(parent: ET.Element, variables: list[Variable] | tuple[Variable, ...]) -> None:
    for one in variables:
        made = _in(parent, "variable", name=one.name)
        _typed(_in(made, "type"), one.type)
        _documented(made, one.comment)


def _typed(parent: ET.Element, kind: str) -> None:
    if kind in _ELEMENTARY:
        _in(parent, kind)
    else:
        _in(parent, "derived", name=kind)


def _documented(parent: ET.Element, comment: str) -> None:
    if comment:
        ET.SubElement(_in(parent, "documentation"), f"{{{XHTML}}}p").text = comment
