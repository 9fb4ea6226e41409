"""A small EDS file that has no defect, and parts to put behind it."""

HEAD = """[FileInfo]
FileName=nobody.eds
[DeviceInfo]
VendorName=Nobody
[MandatoryObjects]
SupportedObjects=3
1=0x1000
2=0x1001
3=0x1018
[OptionalObjects]
SupportedObjects=0
[ManufacturerObjects]
SupportedObjects=1
1=0x2000
[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0x00020192
[1001]
ParameterName=Error register
ObjectType=0x7
DataType=0x0005
AccessType=ro
DefaultValue=0
[1018]
ParameterName=Identity
ObjectType=0x9
SubNumber=2
[1018sub0]
ParameterName=Highest sub-index
ObjectType=0x7
DataType=0x0005
AccessType=const
DefaultValue=1
[1018sub1]
ParameterName=Vendor
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0
"""


def variable(**keys):
    """The section [2000] with an INTEGER16, and other keys as named; None leaves a key out."""
    keys = {"ParameterName": "X", "DataType": "0x0003", "AccessType": "rw"} | keys
    return "[2000]\n" + "".join(f"{key}={value}\n" for key, value in keys.items() if value is not None)


def complaints(description):
    return [str(d).split(":", 1)[1] for d in description.diagnoses]


def record(*heads, kind="0x9", said=None):
    body = "ParameterName=Part\nDataType=0x0005\nAccessType=rw\nDefaultValue=4\n"
    number = "" if said is None else f"SubNumber={said}\n"
    return f"[2000]\nParameterName=Whole\nObjectType={kind}\n{number}" + "".join(f"{head}\n{body}" for head in heads)
