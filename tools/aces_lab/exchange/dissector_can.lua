
-- ------------------------------------------------------------------ CAN frames

local can_id, can_extended, can_remote = Field.new("can.id"), Field.new("can.flags.xtd"), Field.new("can.flags.rtr")
local can_length, can_fd, can_error = Field.new("can.len"), Field.new("canfd.flags.brs"), Field.new("can.flags.err")
local interface = Field.new("frame.interface_id")

local function last(...)
  local count = select("#", ...)
  local found = count > 0 and select(count, ...) or nil
  return found and found.value
end

local by_key = {}

-- The messages that a frame of this identifier and kind may be, in order of trial.
local function candidates(id, is_extended, is_remote, is_fd)
  local key = string.format("%d", id) .. (is_extended and "x" or "") .. (is_remote and "r" or "") .. (is_fd and "f" or "")
  if not by_key[key] then
    by_key[key] = {}
    for _, message in ipairs(P.messages) do
      if not message.transport and message.extended == is_extended and message.remote == is_remote
          and (message.fd == is_fd or message.any_format) and captured(message.id, id, {}) then
        table.insert(by_key[key], message)
      end
    end
  end
  return by_key[key]
end

-- The messages of a transport whose packets have this identifier, in order of trial.
local function carried(transport, id, is_extended)
  local found = {}
  for _, message in ipairs(P.messages) do
    if message.transport == transport.number and message.extended == is_extended and captured(message.id, id, {}) then
      found[#found + 1] = message
    end
  end
  return found
end

local carrier_by_key = {}

-- The transport whose frames have this identifier, or false.
local function carrier_of(id, is_extended, is_remote, is_fd)
  if is_remote then return false end
  local key = string.format("%d", id) .. (is_extended and "x" or "") .. (is_fd and "f" or "")
  if carrier_by_key[key] == nil then
    carrier_by_key[key] = false
    for _, transport in ipairs(P.transports or {}) do
      local is_its = #carried(transport, id, is_extended) > 0
      for _, own in ipairs(transport.patterns) do
        is_its = is_its or (own.extended == is_extended and captured(own, id, {}))
      end
      if is_its and (transport.fd or not is_fd) then
        carrier_by_key[key] = transport
        break
      end
    end
  end
  return carrier_by_key[key]
end

-- What a frame of a transport is: the message that its packet has become, a problem, or a part of a packet.
local function carried_frame(transport, bytes, size, pinfo, id, is_extended)
  local channel, time = tostring(last(interface()) or 0), pinfo.abs_ts
  local source = channel .. "|" .. string.format("%d", id) .. (is_extended and "x" or "")
  local data, problem, place, frames = taken(transport, bytes, size, source, time, pinfo.number)
  if not data then
    -- A packet that this frame ended has its reason already.
    if problem or place then return { problem = problem, place = place, title = transport.title } end
    return known[pinfo.number]
  end
  local messages = carried(transport, id, is_extended)
  if frames then data = unwrapped(transport, data, messages[1] and messages[1].extra or {}) end
  local made = { frames = frames, title = transport.title, problem = not data and "malformed: checksum" or nil }
  if data then
    made.data, made.size = {}, #data
    for at, byte in ipairs(data) do made.data[at - 1] = byte end
    made.found, made.problem = decided(messages, made.data, made.size, id, channel, time, "both")
  end
  for _, frame in ipairs(frames or {}) do
    if frame ~= pinfo.number then
      known[frame] = { problem = made.problem, place = known[frame].place, title = transport.title, whole = pinfo.number }
    end
  end
  return made
end

-- A packet's bytes as Wireshark has bytes of its own.
local function tvb_of(seen)
  local digits = {}
  for at = 0, seen.size - 1 do digits[at + 1] = string.format("%02x", seen.data[at]) end
  return ByteArray.new(table.concat(digits)):tvb("Packet")
end

local function dissect(tvb, pinfo, tree, bytes, size)
  local id = last(can_id())
  if not id or last(can_error()) then return 0 end
  local is_extended, is_remote, is_fd = last(can_extended()) == true, last(can_remote()) == true, can_fd() ~= nil
  local transport = carrier_of(id, is_extended, is_remote, is_fd)
  local messages = transport and {} or candidates(id, is_extended, is_remote, is_fd)
  if not transport and #messages == 0 then return 0 end
  local seen = known[pinfo.number]
  if not seen and transport and pinfo.visited then
    seen = { problem = "not put together: its packet's other frames were not seen in order" }
  elseif not seen and transport then
    seen = carried_frame(transport, bytes, size, pinfo, id, is_extended)
    known[pinfo.number] = seen
  elseif not seen then
    local found, problem = decided(messages, bytes, size, id, tostring(last(interface()) or 0), pinfo.abs_ts, "both")
    seen = { found = found, problem = problem }
    known[pinfo.number] = seen
  end
  pinfo.cols.protocol = P.name:upper()
  local branch = tree:add(proto, tvb:range(0, size))
  if seen.found then
    pinfo.cols.info = summary(seen.found)
    branch:append_text(": " .. summary(seen.found))
    if seen.data and seen.size > 0 then
      if seen.frames then branch:add(f_frames, tvb:range(0, 0), #seen.frames):set_generated() end
      show(branch, tvb_of(seen), seen.data, seen.size, seen.found)
    else
      show(branch, tvb, bytes, size, seen.found)
    end
  else
    local text = seen.problem or seen.place .. " of a packet (" .. seen.title .. ")"
    pinfo.cols.info = text
    branch:append_text(": " .. text)
    if seen.problem and not seen.problem:find("^control") then branch:add(f_problem, tvb:range(0, size), text) end
    if seen.whole then branch:add(f_whole, tvb:range(0, 0), seen.whole):set_generated() end
  end
  return size
end

-- The frame that has been shown in this pass.
local shown_frame

function proto.dissector(tvb, pinfo, tree)
  local bytes, size = bytes_of(tvb)
  shown_frame = pinfo.number
  return dissect(tvb, pinfo, tree, bytes, size)
end

-- Frames that carry no data do not reach a subdissector, or not in every version.
local bare = Proto(prefix .. "_bare", P.title .. " (frames without data)")

function bare.dissector(tvb, pinfo, tree)
  local length = last(can_length())
  if shown_frame ~= pinfo.number and length and (length == 0 or last(can_remote()) == true) then
    dissect(tvb, pinfo, tree, {}, 0)
  end
  shown_frame = nil
end

register_postdissector(bare)
-- What a frame is depends on those before it, and is decided in the first pass: a listener that asks for all fields has
-- Wireshark make them then.
local fields_from_the_start = Listener.new("frame", nil, true)
function fields_from_the_start.packet() end
DissectorTable.get("can.subdissector"):add_for_decode_as(proto)
proto:register_heuristic("can", function(tvb, pinfo, tree)
  return proto.dissector(tvb, pinfo, tree) > 0
end)
