
-- ------------------------------------------------------------------ packets in a stream of bytes

local BY_PORT, TO, FROM, BOTH = 0, 1, 2, 3
proto.prefs.direction = Pref.enum("Direction", P.direction, "Who speaks: what bytes alone may not tell", {
  { 1, "by the port: what comes from it is from the device", BY_PORT },
  { 2, "to the device", TO },
  { 3, "from the device", FROM },
  { 4, "both: replies are recognised by their requests", BOTH },
}, false)
proto.prefs.tcp_port = Pref.uint("TCP port", P.port, "Of a serial server; 0 for none")
proto.prefs.udp_port = Pref.uint("UDP port", P.port, "Of a serial server; 0 for none")

local modes = { [TO] = "to device", [FROM] = "from device", [BOTH] = "both" }

-- Data without stuffing, from 1 on; nil when stuffing cannot have made it.
local unstuff = {}

function unstuff.slip(data)
  local out, at = {}, 1
  while at <= #data do
    local byte = data[at]
    if byte == 0xDB then
      at = at + 1
      byte = data[at] == 0xDC and 0xC0 or data[at] == 0xDD and 0xDB or nil
      if not byte then return nil end
    elseif byte == 0xC0 then
      return nil
    end
    out[#out + 1] = byte
    at = at + 1
  end
  return out
end

function unstuff.cobs(data)
  local out, at, run, before = {}, 1, 0, 0
  if #data == 0 then return nil end
  while at <= #data do
    before, run = run, data[at]
    if run == 0 or at + run - 1 > #data then return nil end
    for index = at + 1, at + run - 1 do
      if data[index] == 0 then return nil end
      out[#out + 1] = data[index]
    end
    at = at + run
    if run < 255 and at <= #data then out[#out + 1] = 0 end
  end
  if before == 255 and run == 1 then return nil end -- one form alone
  return out
end

function unstuff.insert(data, stuffing)
  local out, pattern = {}, stuffing.pattern
  local at = 1
  while at <= #data do
    out[#out + 1] = data[at]
    local is_pattern = #out >= #pattern
    for index = 1, is_pattern and #pattern or 0 do
      if out[#out - #pattern + index] ~= pattern[index] then is_pattern = false end
    end
    at = at + 1
    if is_pattern then
      for _, byte in ipairs(stuffing.bytes) do
        if data[at] ~= byte then return nil end
        at = at + 1
      end
    end
  end
  return out
end

-- The first `count` bytes of what stands at `start`, from 0 on.
local function beginning(bytes, start, count)
  local head = {}
  for at = 0, count - 1 do head[at] = bytes[start + at] end
  return head
end

-- How many bytes are behind the check of the packet at `start`.
local function trailing(framing, bytes, start)
  local length = framing.length
  if not length or not length.flags then return 0 end
  return number(beginning(bytes, start, length.last + 1), length.flags) == 1 and length.more or 0
end

-- The packet with the zeros that were cut off its message, and what is behind the check before it.
local function refilled(framing, bytes, start, size)
  local behind = trailing(framing, bytes, start)
  local stop, tail = size - behind - framing.check.size, size - behind
  local out = beginning(bytes, start, stop)
  local selecting = number(beginning(bytes, start, framing.head_end), framing.extra)
  local count = stop
  while count > framing.head_end and out[count - 1] == 0 do count = count - 1 end
  local least = framing.head_end + (framing.stuffing.sizes[selecting] or 0)
  while count < least do
    out[count] = 0
    count = count + 1
  end
  for _, from in ipairs({ { tail, size }, { stop, tail } }) do
    for at = from[1], from[2] - 1 do
      out[count] = bytes[start + at]
      count = count + 1
    end
  end
  return out, count
end

-- The packet `bytes[start…start+size-1]` without stuffing: bytes from 0 on, and how many; nil when it cannot be.
local function logical(framing, bytes, start, size)
  local head, tail = 0, 0
  local stuffing = framing.stuffing
  if not stuffing then
    head = size
  elseif stuffing.kind == "zeros" then
    return refilled(framing, bytes, start, size)
  elseif stuffing.kind == "wide" then
    -- The wider length goes, where there is one.
    local length = framing.length
    local gone = size - length.constant >= length.escape * length.factor and length.wide_size or 0
    local out = {}
    for at = 0, size - 1 - gone do
      out[at] = bytes[start + at + (at >= framing.head_end and gone or 0)]
    end
    return out, size - gone
  elseif stuffing.kind == "insert" then
    head, tail = framing.head_end, framing.check and framing.check.size or 0
  else
    head, tail = #framing.sync, #framing.stop
  end
  local out, count = {}, 0
  local function put(byte)
    out[count] = byte
    count = count + 1
  end
  for at = start, start + head - 1 do put(bytes[at]) end
  if stuffing then
    local inner = {}
    for at = start + head, start + size - tail - 1 do inner[#inner + 1] = bytes[at] end
    inner = unstuff[stuffing.kind](inner, stuffing)
    if not inner then return nil end
    for _, byte in ipairs(inner) do put(byte) end
    for at = start + size - tail, start + size - 1 do put(bytes[at]) end
  end
  return out, count
end

local function is_check_good(framing, packet, size)
  local check = framing.check
  if not check then return true end
  local stop = size - #framing.stop - check.size
  local extra
  if check.is_seeded then
    extra = P.extras[number(packet, framing.extra)]
    if not extra then return false end
  end
  if not check.kind then return true end -- the remark at the file's head says so
  local value = compute[check.kind](covered(check, packet, size, #framing.sync, stop, 0, extra), check)
  if check.texts then
    for at = 1, check.size do
      local byte = packet[stop + at - 1]
      if check.digits and check.digits[at] and byte >= 97 and byte <= 122 then byte = byte - 32 end
      if byte ~= check.texts[value + 1]:byte(at) then return false end
    end
    return true
  end
  for at = 0, check.size - 1 do
    local power = check.is_big and check.size - 1 - at or at
    if packet[stop + at] ~= floor(value / 256 ^ power) % 256 then return false end
  end
  return true
end

-- What stands at `start`: its size and the packet without stuffing; or "dead", or "more" and how many bytes are there.
local function judged(framing, bytes, start, stop, is_over)
  local left = stop - start
  for at = 1, #framing.sync do
    if at > left then return "more" end
    if bytes[start + at - 1] ~= framing.sync[at] then return "dead" end
  end
  if framing.not_next then
    if left == #framing.sync then return "more" end
    if is_among(bytes[start + #framing.sync], framing.not_next) then return "dead" end
  end
  for _, wanted in ipairs(framing.match or {}) do
    if left <= wanted.at then return "more" end
    if not is_among(bytes[start + wanted.at], wanted.values) then return "dead" end
  end
  local size
  if framing.is_silent then
    if left > framing.max_size then return "dead" end
    if not is_over then return "more" end
    size = left
  elseif #framing.stop > 0 then
    local limit = math.min(stop, start + framing.max_size)
    for at = start + #framing.sync, limit - #framing.stop do
      local is_end = true
      for index = 1, #framing.stop do
        if bytes[at + index - 1] ~= framing.stop[index] then is_end = false end
      end
      if framing.not_inside and not is_end and is_among(bytes[at], framing.not_inside) then return "dead" end
      if is_end then
        size = at + #framing.stop - start
        break
      end
    end
    if not size then
      for at = math.max(start + #framing.sync, limit - #framing.stop + 1), limit - 1 do
        if framing.not_inside and is_among(bytes[at], framing.not_inside) then return "dead" end
      end
      return left < framing.max_size and "more" or "dead"
    end
    if size == #framing.sync + #framing.stop then return "dead" end
  elseif framing.length then
    if left < framing.length.last + 1 then return "more" end
    local length = framing.length
    local head = beginning(bytes, start, length.last + 1)
    local value = number(head, length.pieces)
    if length.wide and value >= length.escape then
      if value > length.escape then return "dead" end
      local last = length.last + length.wide_size
      if left < last + 1 then return "more" end
      for at = length.last + 1, last do head[at] = bytes[start + at] end
      value = number(head, length.wide)
      if value < length.escape then return "dead" end
      size = length.wide_size
    end
    size = (size or 0) + length.factor * value + length.constant + trailing(framing, bytes, start)
  else
    size = framing.size
  end
  if #framing.stop == 0 and not framing.is_silent
    and (size < framing.min_size or size > framing.max_size or size % (framing.multiple or 1) ~= 0) then
    return "dead"
  end
  if left < size then return "more" end
  local packet, count = logical(framing, bytes, start, size)
  local kind = framing.stuffing and framing.stuffing.kind
  local is_inserted = kind == "insert" or kind == "wide" or kind == "zeros"
  if not packet or count < framing.min_size then return "dead" end
  local covered_packet, covered_size = packet, count
  if is_inserted then
    covered_size = size - trailing(framing, bytes, start)
    covered_packet = beginning(bytes, start, covered_size)
  end
  if not is_check_good(framing, covered_packet, covered_size) then return "dead" end
  return size, packet, count
end

-- The packets of some bytes, each with what `tell` says of it; and where the undecided ones begin. At the lowest
-- undecided place the framings are tried in their order: one that is whole and a message is taken, then one that is whole.
local function scanned(bytes, stop, is_over, tell)
  local found, at = {}, 0
  while at < stop do
    local taken
    for _, framing in ipairs(P.framings) do
      local size, packet, count = judged(framing, bytes, at, stop, is_over)
      if size == "more" and not is_over then return found, at end
      if type(size) == "number" then
        local one = { start = at, size = size, framing = framing, packet = packet, count = count }
        one.found, one.problem = tell(one)
        if one.found or not taken then taken = one end
        if one.found then break end
      end
    end
    found[#found + 1] = taken
    at = at + (taken and taken.size or 1)
  end
  return found, at
end

local function show_packet(branch, tvb, one)
  local part = tvb:range(one.start, one.size)
  local leaf = branch:add(part, one.found and summary(one.found) or one.problem)
  if not one.found then
    leaf:add(f_problem, part, one.problem)
    return
  end
  local inner = part:tvb()
  if one.framing.stuffing then
    local array = ByteArray.new()
    array:set_size(one.count)
    for at = 0, one.count - 1 do array:set_index(at, one.packet[at]) end
    inner = array:tvb("without stuffing")
  end
  show(leaf, inner, one.packet, one.count, one.found)
end

local function dissect(tvb, pinfo, tree, mode, channel, is_over)
  local bytes, stop = bytes_of(tvb)
  local memory = known[pinfo.number] or {}
  known[pinfo.number] = memory
  local packets, undecided = scanned(bytes, stop, is_over, function(one)
    local key = mode .. channel .. "|" .. tvb:offset() + one.start .. "|" .. one.framing.name
    if not memory[key] then
      local messages = {}
      for _, message in ipairs(P.messages) do
        if P.framings[message.framing] == one.framing and message.bound[mode] ~= nil then
          messages[#messages + 1] = message
        end
      end
      memory[key] = { decided(messages, one.packet, one.count, 0, channel, pinfo.abs_ts, mode) }
    end
    return memory[key][1], memory[key][2]
  end)
  local branch = tree:add(proto, tvb:range(0, undecided))
  local texts, done = {}, 0
  for _, one in ipairs(packets) do
    if one.start > done then branch:add(f_skipped, tvb:range(done, one.start - done)) end
    done = one.start + one.size
    texts[#texts + 1] = one.found and summary(one.found) or one.problem
    show_packet(branch, tvb, one)
  end
  if undecided > done then branch:add(f_skipped, tvb:range(done, undecided - done)) end
  pinfo.cols.protocol = P.name:upper()
  if #texts > 0 then pinfo.cols.info = table.concat(texts, "; ", 1, math.min(#texts, 8)) end
  return undecided
end

local function mode_of(pinfo, port)
  local mode = modes[proto.prefs.direction]
  if mode then return mode end
  if port == 0 or port == nil then return "both" end
  return pinfo.src_port == port and "from device" or pinfo.dst_port == port and "to device" or "both"
end

local function channel_of(pinfo, port)
  if port == nil then return "" end
  local mine, other = tostring(pinfo.src) .. ":" .. pinfo.src_port, tostring(pinfo.dst) .. ":" .. pinfo.dst_port
  return mine < other and mine .. "-" .. other or other .. "-" .. mine
end

-- Datagrams and frames of a user's link type: packets do not go on in the next one.
function proto.dissector(tvb, pinfo, tree)
  local is_datagram = pinfo.src_port ~= nil and pinfo.src_port > 0
  local port = is_datagram and proto.prefs.udp_port or nil
  return dissect(tvb, pinfo, tree, mode_of(pinfo, port), channel_of(pinfo, port), true)
end

-- A stream: what is not decided yet waits for the next segment.
local over_tcp = Proto(prefix .. "_tcp", P.title .. " (over TCP)")

function over_tcp.dissector(tvb, pinfo, tree)
  local port = proto.prefs.tcp_port
  local undecided = dissect(tvb, pinfo, tree, mode_of(pinfo, port), channel_of(pinfo, port), false)
  if undecided < tvb:len() then
    pinfo.desegment_offset = undecided
    pinfo.desegment_len = DESEGMENT_ONE_MORE_SEGMENT
  end
  return tvb:len()
end

local tcp, udp = DissectorTable.get("tcp.port"), DissectorTable.get("udp.port")
local at_tcp, at_udp = 0, 0

local function listen()
  if at_tcp > 0 then tcp:remove(at_tcp, over_tcp) end
  if at_udp > 0 then udp:remove(at_udp, proto) end
  at_tcp, at_udp = proto.prefs.tcp_port, proto.prefs.udp_port
  if at_tcp > 0 then tcp:add(at_tcp, over_tcp) end
  if at_udp > 0 then udp:add(at_udp, proto) end
end

proto.prefs_changed = listen
listen()
tcp:add_for_decode_as(over_tcp)
udp:add_for_decode_as(proto)
DissectorTable.get("wtap_encap"):add(wtap.USER0, proto)
