"""The same small board in every format.

R1 lies on the top, J1 is turned by 90° with its body beside its origin, C1 lies on the bottom.
"""

# ruff: noqa: E501  (lines of the formats)

from __future__ import annotations

import io
import zipfile

KICAD = """(kicad_pcb (version 20240108) (generator "pcbnew")
  (title_block (title "sample"))
  (footprint "R:R_0805_2012Metric" (layer "F.Cu") (at 10 -10)
    (property "Reference" "R1" (at 0 0)) (property "Value" "10k \\"1%\\"")
    (fp_rect (start -1 -0.6) (end 1 0.6) (layer "F.Fab"))
    (pad "1" smd rect (at -0.9 0) (size 1 1.4) (layers "F.Cu")))
  (footprint "C:J" (layer "F.Cu") (at 30 -20 90)
    (property "Reference" "J1")
    (fp_line (start 0 -2) (end 8 -2) (layer "F.CrtYd")) (fp_line (start 8 -2) (end 8 2) (layer "F.CrtYd")))
  (footprint "C:C_0402_1005Metric" (layer "B.Cu") (at 15 -25 270) (attr smd dnp)
    (property "Reference" "C1")
    (pad "1" smd rect (at -0.5 0 270) (size 0.5 0.6)) (pad "2" smd rect (at 0.5 0 270) (size 0.5 0.6)))
  (footprint "Fiducial:Fiducial_1mm" (layer "F.Cu") (at 5 -5)
    (property "Reference" "FID1") (pad "" smd circle (at 0 0) (size 1.2 1.2)))
  (footprint "Logo:L" (layer "F.Cu") (at 1 -1) (attr exclude_from_pos_files) (property "Reference" "G1"))
  (gr_line (start 0 0) (end 50 0) (layer "Edge.Cuts")) (gr_line (start 50 0) (end 50 -40) (layer "Edge.Cuts"))
  (gr_arc (start 50 -40) (mid 25 -45) (end 0 -40) (layer "Edge.Cuts")) (gr_line (start 0 -40) (end 0 0) (layer "Edge.Cuts"))
  (gr_circle (center 25 -20) (end 28 -20) (layer "Edge.Cuts"))
)"""

GENCAD = """$HEADER
GENCAD 1.4
DRAWING "sample.kicad_pcb"
UNITS USER 1000
$ENDHEADER
$BOARD
LINE 0 0 1968.504 0
LINE 1968.504 0 1968.504 1574.803
LINE 1968.504 1574.803 0 1574.803
LINE 0 1574.803 0 0
$ENDBOARD
$PADS
PAD P1 ROUND 0
CIRCLE 0 0 23.622
$ENDPADS
$PADSTACKS
PADSTACK S1 0
PAD P1 TOP 0 0
$ENDPADSTACKS
$SHAPES
SHAPE "R"
LINE -39.3701 -23.622 39.3701 -23.622
LINE 39.3701 23.622 -39.3701 23.622
SHAPE "J"
RECTANGLE 0 -78.7402 314.9606 157.4803
HEIGHT 118.1102
SHAPE "Fiducial"
PIN "1" S1 0 0 TOP 0 0
$ENDSHAPES
$COMPONENTS
COMPONENT "R1"
PLACE 393.7008 393.7008
LAYER TOP
ROTATION 0
SHAPE "R" 0 0
COMPONENT "J1"
PLACE 1181.1024 787.4016
LAYER TOP
ROTATION 90
SHAPE "J" 0 0
COMPONENT "C1"
PLACE 590.5512 984.252
LAYER BOTTOM
ROTATION 270
SHAPE "J" MIRRORX FLIP
COMPONENT "FID1"
PLACE 196.8504 196.8504
LAYER TOP
SHAPE "Fiducial" 0 0
COMPONENT "X1"
LAYER TOP
$ENDCOMPONENTS
"""

IPC2581 = """<?xml version="1.0" encoding="UTF-8"?>
<IPC-2581 revision="B" xmlns="http://webstds.ipc.org/2581">
 <Content><DictionaryStandard units="INCH"><EntryStandard id="P1"><Circle diameter="0.04724409"/></EntryStandard></DictionaryStandard></Content>
 <Bom><BomItem><RefDes name="C1" populate="false"/></BomItem></Bom>
 <Ecad><CadHeader units="INCH"/><CadData>
  <Layer name="TOP" side="TOP"/><Layer name="BOT" side="BOTTOM"/>
  <Step name="sample">
   <Profile><Polygon><PolyBegin x="0" y="0"/><PolyStepSegment x="1.9685" y="0"/><PolyStepSegment x="1.9685" y="1.5748"/>
    <PolyStepCurve x="0" y="1.5748" centerX="0.98425" centerY="1.5748" clockwise="false"/><PolyStepSegment x="0" y="0"/></Polygon></Profile>
   <Package name="R" height="0.02"><Outline><Polygon><PolyBegin x="-0.0393701" y="-0.023622"/><PolyStepSegment x="0.0393701" y="-0.023622"/>
     <PolyStepSegment x="0.0393701" y="0.023622"/></Polygon></Outline></Package>
   <Package name="J"><Outline><Polygon><PolyBegin x="0" y="-0.0787402"/><PolyStepSegment x="0.3149606" y="-0.0787402"/>
     <PolyStepSegment x="0.3149606" y="0.0787402"/></Polygon></Outline>
     <Pin number="1"><Location x="0.2" y="0.05"/><StandardPrimitiveRef id="P1"/></Pin></Package>
   <Component refDes="R1" packageRef="R" layerRef="TOP"><Location x="0.3937008" y="0.3937008"/></Component>
   <Component refDes="J1" packageRef="J" layerRef="TOP"><Xform rotation="90"/><Location x="1.1811024" y="0.7874016"/></Component>
   <Component refDes="C1" packageRef="J" layerRef="BOT"><Xform rotation="90" mirror="true"/><Location x="0.5905512" y="0.984252"/></Component>
   <LayerFeature layerRef="BOT"><Set><Pad><Location x="0.6405512" y="1.184252"/><PinRef componentRef="C1" pin="1"/></Pad></Set></LayerFeature>
   <LayerFeature layerRef="TOP"><Set><GlobalFiducial><Location x="0.1968504" y="0.1968504"/><StandardPrimitiveRef id="P1"/></GlobalFiducial></Set></LayerFeature>
  </Step>
 </CadData></Ecad>
</IPC-2581>"""

ODB = {
    "job/matrix/matrix": "STEP {\n NAME=PCB\n}\n",
    "job/misc/info": "UNITS=MM\n",
    "job/steps/pcb/profile": "UNITS=MM\nS P 0\nOB 0 0 I\nOS 50 0\nOS 50 40\nOC 0 40 25 40 N\nOE\nOB 20 20 H\nOS 30 20\nOS 30 30\nOE\nSE\n",
    "job/steps/pcb/eda/data": (
        "UNITS=MM\n# PKG 0\nPKG R 0 -2 -1 2 1;0=1\nRC -1 -0.6 2 1.2\nPIN 1 S -0.9 0 0 U U\nRC -1.4 -0.7 1 1.4\n"
        "PKG J 0 0 -2 8 2;\nCT\nOB 0 -2 I\nOS 8 -2\nOS 8 2\nOE\nCE\nPKG Fiducial 0 -0.6 -0.6 0.6 0.6;\nPIN 1 S 0 0 0 U U\nCR 0 0 0.6\n"
    ),
    "job/steps/pcb/layers/comp_+_top/components": (
        "UNITS=MM\n@0 .comp_height\n@1 .no_pop\nCMP 0 10 10 0 N R1 10k;0=0.55\nTOP 0 9 10 0 N 1 0 1\n"
        "CMP 1 30 20 270 N J1 conn ;\nCMP 2 5 5 0 N FID1 fid ;\n"
    ),
    "job/steps/pcb/layers/comp_+_bot/components": "UNITS=INCH\n@0 .no_pop\nCMP 1 0.59055118 0.98425197 90 M C1 c;0\n",
}

EAGLE = """<?xml version="1.0" encoding="utf-8"?>
<!DOCTYPE eagle SYSTEM "eagle.dtd">
<eagle version="9.6"><drawing><board>
 <plain><wire x1="0" y1="0" x2="50" y2="0" layer="20"/><wire x1="50" y1="0" x2="50" y2="40" layer="20"/>
  <wire x1="50" y1="40" x2="0" y2="40" curve="180" layer="20"/><wire x1="0" y1="40" x2="0" y2="0" layer="20"/></plain>
 <libraries><library name="l"><packages>
  <package name="R"><wire x1="-1" y1="-0.6" x2="1" y2="-0.6" layer="51"/><wire x1="1" y1="-0.6" x2="1" y2="0.6" layer="51"/></package>
  <package name="J"><rectangle x1="0" y1="-2" x2="8" y2="2" layer="21"/><pad name="1" x="1" y="0" drill="0.8"/></package>
  <package name="FIDUCIAL"><smd name="1" x="0" y="0" dx="1.2" dy="1.2"/></package>
 </packages></library></libraries>
 <elements>
  <element name="R1" library="l" package="R" value="10k" x="10" y="10"/>
  <element name="J1" library="l" package="J" value="" x="30" y="20" rot="R90"/>
  <element name="C1" library="l" package="J" value="" x="15" y="25" rot="MR270"><attribute name="POPULATE" value="no"/></element>
  <element name="FID1" library="l" package="FIDUCIAL" value="" x="5" y="5"/>
 </elements></board></drawing></eagle>"""

HTML_BOM = (
    '{"edges_bbox": {}, "metadata": {"title": "sample"}, "bom": {"skipped": [2]}, "edges": ['
    '{"type": "segment", "start": [0, 0], "end": [50, 0]}, {"type": "segment", "start": [50, 0], "end": [50, -40]},'
    '{"type": "arc", "start": [25, -40], "radius": 25, "startangle": 180, "endangle": 360},'
    '{"type": "segment", "start": [0, -40], "end": [0, 0]}], "footprints": ['
    '{"ref": "R1", "layer": "F", "bbox": {"pos": [10, -10], "relpos": [-1, -0.6], "size": [2, 1.2], "angle": 0}},'
    '{"ref": "J1", "layer": "F", "bbox": {"pos": [30, -20], "relpos": [0, -2], "size": [8, 4], "angle": 90}},'
    '{"ref": "C1", "layer": "B", "bbox": {"pos": [15, -25], "relpos": [-8, -2], "size": [8, 4], "angle": 270}}]}'
)


def odb_zip(members: dict[str, str] | None = None) -> bytes:
    """Return the ODB++ sample as a zip file."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as zipped:
        for name, text in (ODB if members is None else members).items():
            zipped.writestr(name, text)
    return buffer.getvalue()


# The board four times on a panel of 120 × 100 mm: two side by side, one turned by 90° counter-clockwise, one upside
# down. The datum of the board is at (2, 1).
ODB_PANEL = {
    "job/matrix/matrix": "STEP {\n NAME=PCB\n}\nSTEP {\n NAME=PANEL\n}\nLAYER {\n ROW=1\n TYPE=SIGNAL\n NAME=TOP\n}\n",
    "job/steps/pcb/stephdr": "UNITS=MM\nX_DATUM=2\nY_DATUM=1\nX_ORIGIN=0\nY_ORIGIN=0\n",
    "job/steps/panel/stephdr": (
        "UNITS=INCH\nX_DATUM=0\nY_DATUM=0\nSTEP-REPEAT {\n  NAME=PCB\n  X=0.27559055\n  Y=0.23622047\n  DX=2.16535433\n"
        "  DY=0\n  NX=2\n  NY=1\n  ANGLE=0\n  MIRROR=NO\n}\nSTEP-REPEAT {\n  NAME=PCB\n  X=1.92913386\n  Y=2.04724409\n"
        "  NX=1\n  NY=1\n  ANGLE=270\n  FLIP=NO\n  MIRROR=NO\n}\nSTEP-REPEAT {\n  NAME=PCB\n  X=4.21259843\n  Y=1.96850394\n"
        "  NX=1\n  NY=1\n  ANGLE=0\n  FLIP=YES\n  MIRROR=NO\n}\nTOP_ACTIVE=0\n"
    ),
    "job/steps/panel/profile": "UNITS=MM\nS P 0\nOB 0 0 I\nOS 120 0\nOS 120 100\nOS 0 100\nOE\nSE\n",
    "job/steps/panel/layers/top/features": (
        "UNITS=MM\n$0 r1000\n@0 .pad_usage\n@1 .fiducial_name\n&0 BADBOARD\nP 3 3 0 P 0 0;0=2\nP 117 97 0 P 0 0;0=2\n"
        "P 118 3 0 P 0 0;1=0\nP 80 20 0 P 0 0;1=0\n"
    ),
}

_PANEL_STEP = """<Step name="panel"><Datum x="0" y="0"/>
   <Profile><Polygon><PolyBegin x="0" y="0"/><PolyStepSegment x="4.72440945" y="0"/><PolyStepSegment x="4.72440945" y="3.93700787"/>
    <PolyStepSegment x="0" y="3.93700787"/></Polygon></Profile>
   <StepRepeat stepRef="sample" x="0.27559055" y="0.23622047" nx="2" ny="1" dx="2.16535433" dy="0" angle="0.00" mirror="false"/>
   <StepRepeat stepRef="sample" x="1.92913386" y="2.04724409" nx="1" ny="1" dx="0" dy="0" angle="90.00" mirror="false"/>
   <StepRepeat stepRef="sample" x="4.21259843" y="1.96850394" nx="1" ny="1" dx="0" dy="0" angle="0" mirror="true"/>
   <LayerFeature layerRef="TOP"><Set><GlobalFiducial><Location x="0.11811024" y="0.11811024"/></GlobalFiducial>
    <GoodPanelMark><Location x="4.60629921" y="3.81889764"/></GoodPanelMark>
    <BadBoardMark><Location x="3.1496063" y="0.78740157"/></BadBoardMark></Set></LayerFeature>
  </Step>"""
IPC2581_PANEL = IPC2581.replace(
    '<Step name="sample">', _PANEL_STEP + '<Step name="sample"><Datum x="0.07874016" y="0.03937008"/>'
)
