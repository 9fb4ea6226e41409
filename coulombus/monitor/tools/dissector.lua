-- Wireshark's dissector of one rig. `coulombus tools` writes the tables in front of it: RIG, NODES, PDOS, SERVICES,
-- EMCY, STATES, COMMANDS. It takes PDOs, SYNC, NMT, heartbeats and emergencies; SDO is left to the CANopen dissector.

local coulombus = Proto("coulombus", "Coulombus rig " .. RIG)
local fields = {}

local function add(key, make, label, ...)
    fields[key] = make("coulombus." .. key, label, ...)
    return fields[key]
end

add("node", ProtoField.string, "Node")
add("pdo", ProtoField.string, "PDO")
add("service", ProtoField.string, "Service")
add("sync_delay", ProtoField.double, "Time since SYNC [s]")
add("emcy.code", ProtoField.uint16, "Error code", base.HEX, EMCY)
add("emcy.register", ProtoField.uint8, "Error register", base.HEX)
add("emcy.manufacturer", ProtoField.bytes, "Manufacturer's bytes")
add("heartbeat.state", ProtoField.uint8, "NMT state", base.DEC, STATES, 0x7F)
add("nmt.command", ProtoField.uint8, "Command", base.DEC, COMMANDS)
add("nmt.node", ProtoField.uint8, "Node id", base.DEC)
add("sync.counter", ProtoField.uint8, "Counter", base.DEC)

for _, pdo in pairs(PDOS) do
    for _, field in ipairs(pdo.fields) do
        if field.parts then
            add(field.key, ProtoField.uint16, field.label, base.HEX)
            for _, part in ipairs(field.parts) do
                local key = field.key .. "." .. part.key
                if part.values then
                    add(key, ProtoField.string, part.key) -- of many words one name: text compares, a number would not
                elseif part.flag then
                    add(key, ProtoField.bool, part.key, 16, nil, part.mask)
                else
                    add(key, ProtoField.uint16, part.key, base.DEC, nil, part.mask)
                end
            end
        else
            add(field.key, ProtoField.double, field.label)
        end
    end
end
local listed = {}
for _, field in pairs(fields) do table.insert(listed, field) end
coulombus.fields = listed

local emergency = ProtoExpert.new("coulombus.emcy.expert", "Emergency", expert.group.RESPONSE_CODE, expert.severity.ERROR)
local wrong = ProtoExpert.new("coulombus.length.expert", "Wrong length", expert.group.MALFORMED, expert.severity.WARN)
coulombus.experts = { emergency, wrong }

local can_id = Field.new("can.id")
local last_sync, delays = nil, {}

function coulombus.init() last_sync, delays = nil, {} end

local function raw_of(tvb, field)
    local word = UInt64(0)
    for i = math.min(tvb:len(), 8) - 1, 0, -1 do word = word:lshift(8):bor(UInt64(tvb(i, 1):uint())) end
    word = word:lshift(64 - field.start - field.bits)
    if field.signed and not field.real then
        return Int64(word:lower(), word:higher()):arshift(64 - field.bits):tonumber()
    end
    return word:rshift(64 - field.bits):tonumber()
end

local function value_of(tvb, field)
    if field.real and field.bits == 64 then return tvb(0, 8):le_float() end
    local raw = raw_of(tvb, field)
    if field.real then raw = Struct.unpack("<f", Struct.pack("<I4", raw)) end
    return raw * field.scale + field.offset
end

local function bytes_of(tvb, field)
    local first = math.floor(field.start / 8)
    return tvb(first, math.floor((field.start + field.bits - 1) / 8) - first + 1)
end

local function show_pdo(tvb, tree, pdo)
    local words = {}
    for _, field in ipairs(pdo.fields) do
        if field.parts then
            local word = raw_of(tvb, field)
            local branch = tree:add(fields[field.key], bytes_of(tvb, field), word)
            for _, part in ipairs(field.parts) do
                local shown = part.values and (part.values[bit.band(word, part.mask)] or "unknown") or word
                branch:add(fields[field.key .. "." .. part.key], bytes_of(tvb, field), shown)
                if part.values then
                    branch:append_text(": " .. shown)
                    table.insert(words, shown)
                end
            end
        else
            local value = value_of(tvb, field)
            local unit = field.unit == "" and "" or " " .. field.unit
            tree:add(fields[field.key], bytes_of(tvb, field), value):append_text(unit .. "  (" .. field.object .. ")")
            table.insert(words, string.format("%s %+.5g%s", field.label, value, unit))
        end
    end
    return table.concat(words, ", ")
end

local show = {}

function show.sync(tvb, tree)
    if tvb:len() > 0 then tree:add(fields["sync.counter"], tvb(0, 1)) end
    return ""
end

function show.nmt(tvb, tree)
    local command, node = tvb(0, 1):uint(), tvb(1, 1):uint()
    tree:add(fields["nmt.command"], tvb(0, 1))
    tree:add(fields["nmt.node"], tvb(1, 1))
    return (COMMANDS[command] or "command " .. command) .. ", to " .. (node == 0 and "all" or NODES[node] or node)
end

function show.heartbeat(tvb, tree)
    tree:add(fields["heartbeat.state"], tvb(0, 1))
    local state = bit.band(tvb(0, 1):uint(), 0x7F)
    return STATES[state] or "state " .. state
end

function show.emcy(tvb, tree)
    local code = tvb(0, 2):le_uint()
    local item = tree:add_le(fields["emcy.code"], tvb(0, 2))
    if code ~= 0 then item:add_proto_expert_info(emergency) end
    tree:add(fields["emcy.register"], tvb(2, 1))
    tree:add(fields["emcy.manufacturer"], tvb(3, 5))
    return string.format("0x%04X: %s, register %02Xh", code, EMCY[code] or "not listed", tvb(2, 1):uint())
end

local least = { sync = 0, nmt = 2, heartbeat = 1, emcy = 8 }

function coulombus.dissector(tvb, pinfo, root)
    local id = can_id().value
    local pdo, service = PDOS[id], SERVICES[id]
    local tree = root:add(coulombus, tvb())
    local node = pdo and pdo.node or service.node
    local what = pdo and pdo.pdo or service.name
    pinfo.cols.protocol = "Coulombus"
    if node then tree:add(fields["node"], node):set_generated() end
    tree:add(fields[pdo and "pdo" or "service"], what):set_generated()
    if what == "sync" then
        if not pinfo.visited then last_sync = pinfo.abs_ts end
    elseif pdo then
        if not pinfo.visited and last_sync then delays[pinfo.number] = pinfo.abs_ts - last_sync end
        if delays[pinfo.number] then tree:add(fields["sync_delay"], delays[pinfo.number]):set_generated() end
    end
    local head = (node and node .. " " or "") .. what
    tree:append_text(": " .. head)
    if pdo and tvb:len() ~= pdo.length or not pdo and tvb:len() < least[what] then
        tree:add_proto_expert_info(wrong)
        pinfo.cols.info = head .. ", wrong length " .. tvb:len()
        return
    end
    local said = pdo and show_pdo(tvb, tree, pdo) or not pdo and show[what](tvb, tree) or ""
    pinfo.cols.info = head .. (said == "" and "" or "  " .. said)
end

local ids, extended = DissectorTable.get("can.id"), DissectorTable.get("can.extended_id")
for id in pairs(PDOS) do
    if id < 0x800 then ids:add(id, coulombus) elseif extended then extended:add(id, coulombus) end
end
for id in pairs(SERVICES) do ids:add(id, coulombus) end
