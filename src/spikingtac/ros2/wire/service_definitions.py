"""Requests and answers of the services of a node, as std_srvs and rcl_interfaces publish them.

What has no field has one of a byte, as every generator of ROS 2 makes it.
"""

from __future__ import annotations

NOTHING = "uint8 structure_needs_at_least_one_member"

SERVICE_PARTS = {
    "std_srvs/Trigger_Request": NOTHING,
    "std_srvs/Trigger_Response": "bool success\nstring message",
    "rcl_interfaces/ListParameters_Request": (
        "uint64 DEPTH_RECURSIVE=0\nstring[] prefixes\nuint64 depth"
    ),
    "rcl_interfaces/ListParameters_Response": "rcl_interfaces/ListParametersResult result",
    "rcl_interfaces/GetParameters_Request": "string[] names",
    "rcl_interfaces/GetParameters_Response": "rcl_interfaces/ParameterValue[] values",
    "rcl_interfaces/GetParameterTypes_Request": "string[] names",
    "rcl_interfaces/GetParameterTypes_Response": "uint8[] types",
    "rcl_interfaces/DescribeParameters_Request": "string[] names",
    "rcl_interfaces/DescribeParameters_Response": (
        "rcl_interfaces/ParameterDescriptor[] descriptors"
    ),
    "rcl_interfaces/SetParameters_Request": "rcl_interfaces/Parameter[] parameters",
    "rcl_interfaces/SetParameters_Response": "rcl_interfaces/SetParametersResult[] results",
    "rcl_interfaces/SetParametersAtomically_Request": "rcl_interfaces/Parameter[] parameters",
    "rcl_interfaces/SetParametersAtomically_Response": "rcl_interfaces/SetParametersResult result",
}
"""Package, service and part -> its definition."""

PARAMETER_MESSAGES = {
    "rcl_interfaces/ParameterValue": (
        "uint8 type\nbool bool_value\nint64 integer_value\nfloat64 double_value\n"
        "string string_value\nbyte[] byte_array_value\nbool[] bool_array_value\n"
        "int64[] integer_array_value\nfloat64[] double_array_value\nstring[] string_array_value"
    ),
    "rcl_interfaces/Parameter": "string name\nrcl_interfaces/ParameterValue value",
    "rcl_interfaces/FloatingPointRange": "float64 from_value\nfloat64 to_value\nfloat64 step",
    "rcl_interfaces/IntegerRange": "int64 from_value\nint64 to_value\nuint64 step",
    "rcl_interfaces/ParameterDescriptor": (
        "string name\nuint8 type\nstring description\nstring additional_constraints\n"
        "bool read_only\nbool dynamic_typing\n"
        "rcl_interfaces/FloatingPointRange[<=1] floating_point_range\n"
        "rcl_interfaces/IntegerRange[<=1] integer_range"
    ),
    "rcl_interfaces/ListParametersResult": "string[] names\nstring[] prefixes",
    "rcl_interfaces/SetParametersResult": "bool successful\nstring reason",
    "rcl_interfaces/ParameterEvent": (
        "builtin_interfaces/Time stamp\nstring node\nrcl_interfaces/Parameter[] new_parameters\n"
        "rcl_interfaces/Parameter[] changed_parameters\n"
        "rcl_interfaces/Parameter[] deleted_parameters"
    ),
}
"""Package and name of what the services of parameters speak of -> its definition."""

HUMBLE = "@humble"
"""Ends the name of a definition that Humble has, and later releases have otherwise."""
NODE_MESSAGES = {
    "rmw_dds_common/Gid": "char[16] data",
    "rmw_dds_common/NodeEntitiesInfo": (
        "string<=256 node_namespace\nstring<=256 node_name\n"
        "rmw_dds_common/Gid[] reader_gid_seq\nrmw_dds_common/Gid[] writer_gid_seq"
    ),
    "rmw_dds_common/ParticipantEntitiesInfo": (
        "rmw_dds_common/Gid gid\nrmw_dds_common/NodeEntitiesInfo[] node_entities_info_seq"
    ),
}
"""How a participant says which nodes it has, since Iron; Humble's ids are longer."""
NODE_MESSAGES |= {
    f"{name}{HUMBLE}": text.replace("[16]", "[24]")
    .replace("Gid ", f"Gid{HUMBLE} ")
    .replace("Gid[]", f"Gid{HUMBLE}[]")
    .replace("Info[]", f"Info{HUMBLE}[]")
    for name, text in NODE_MESSAGES.items()
}
