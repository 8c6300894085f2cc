
-- ------------------------------------------------------------------ packets of several frames

-- A transport is a table of the kinds of its frames; what they make together is the rule that scanners carry out
-- (`Transport` in the language of specs). A frame is decided about in the first pass, in order; when a packet is given up,
-- its frames get their problem then.

-- The number in a frame's data, or nil where the frame is too short for it.
local function number_in(place, bytes, size)
  local start = place.byte >= 0 and place.byte or size + place.byte
  if start < 0 or start + place.size > size then return nil end
  local value = 0
  for at = 0, place.size - 1 do
    value = value * 256 + bytes[start + (place.is_big and at or place.size - 1 - at)]
  end
  return floor(value / 2 ^ place.shift) % 2 ^ place.width
end

local function fits(kind, body, size)
  if size <= kind.over then return false end
  for _, one in ipairs(kind.match) do
    if number_in(one[1], body, size) ~= one[2] then return false end
  end
  return true
end

local function listed(bytes, start, stop)
  local found = {}
  for at = start, stop - 1 do found[#found + 1] = bytes[at] end
  return found
end

local function appended(list, more)
  for _, byte in ipairs(more) do list[#list + 1] = byte end
  return list
end

local function is_same(one, other)
  return table.concat(one, ",") == table.concat(other, ",")
end

-- What a frame is: its kind, session, piece of the packet, size of the packet, number; or nil and why it is none.
local function part_of(transport, bytes, size)
  local address, body = listed(bytes, 0, math.min(size, transport.address)), part(bytes, transport.address, size - transport.address)
  local left, kind = size - transport.address, nil
  for _, one in ipairs(transport.kinds) do
    if left > 0 and fits(one, body, left) then
      kind = one
      break
    end
  end
  local none = "malformed: no frame of " .. transport.title
  if not kind then return nil, none end
  if kind.role == "control" then return nil, "control: " .. kind.name end
  local sequence = kind.sequence and number_in(kind.sequence, body, left)
  local made = {
    role = kind.role,
    session = table.concat(address, ",") .. "|" .. shown(sequence),
    piece = listed(body, kind.head, left - kind.tail),
    number = 0,
    is_last = kind.last and number_in(kind.last, body, left) == 1,
  }
  if kind.number then made.number = number_in(kind.number, body, left) end
  local has_room = kind.head + kind.tail <= left
  if made.role == "next" and made.number and has_room then return made end
  made.size = kind.sized and number_in(kind.sized, body, left)
  if not made.number or (kind.sized and not made.size) or not has_room then return nil, "malformed: length" end
  if made.size and (made.size < kind.least or made.size > kind.most) then return nil, "malformed: length" end
  if made.role == "single" then
    if made.size and made.size > #made.piece then return nil, "malformed: length" end
    while made.size and #made.piece > made.size do made.piece[#made.piece] = nil end
  elseif made.role == "first" then
    if made.size and made.size > transport.max_size then return nil, "malformed: too long" end
    made.size = made.size and made.size + transport.address
  else
    return nil, none
  end
  made.piece = appended(address, made.piece)
  return made
end

local function named(packet, place)
  return "frame " .. (place + 1) .. (packet.total > 0 and " of " .. packet.total or "")
end

local function due_in(packet)
  local place = 1
  while packet.pieces[place] do place = place + 1 end
  return place
end

-- Why a packet is given up: frames that came without one before them say more than the occasion.
local function why_lost(packet, reason)
  local due = due_in(packet)
  for place in pairs(packet.pieces) do
    if place > due then return "malformed: " .. named(packet, due) .. " missing" end
  end
  return "malformed: " .. reason
end

local function joined(packet)
  local data = appended({}, packet.first)
  for place = 1, packet.count do appended(data, packet.pieces[place]) end
  while packet.size and #data > packet.size do data[#data] = nil end
  return data
end

local function give_up(key, reason)
  local packet = under_way[key]
  under_way[key], count_open = nil, count_open - 1
  for _, frame in ipairs(packet.frames) do known[frame] = { problem = reason } end
end

-- The oldest packet of a transport makes place for one more.
local function make_place(transport)
  local count, oldest = 0, nil
  for key, packet in pairs(under_way) do
    if packet.transport == transport then
      count = count + 1
      if not oldest or packet.order < under_way[oldest].order then oldest = key end
    end
  end
  if count >= transport.senders then give_up(oldest, "malformed: too many senders at once") end
end

local function begun(transport, key, made, bytes, size, time, frame)
  local following = transport.following
  local room = size - transport.address - following.head - following.tail
  local packet = {
    transport = transport, first = made.piece, size = made.size, room = room, total = 0, pieces = {}, count = 0,
    frames = { frame }, time = time, latest = listed(bytes, 0, size), order = opened,
  }
  if made.size and room > 0 then
    packet.total = 1 + math.max(0, math.ceil((made.size - #made.piece) / room))
  end
  if made.is_last or (made.size and packet.total == 1) then return joined(packet) end
  if not transport.full[size] then return nil, "malformed: first frame is short" end
  if count_open >= transport.senders then make_place(transport) end
  under_way[key], opened, count_open = packet, opened + 1, count_open + 1
  return nil, nil, named(packet, 0)
end

local function continued(transport, key, packet, made, bytes, size, time, frame)
  local pieces, own = packet.pieces, listed(bytes, 0, size)
  local place, is_repeated, is_wrong
  if transport.any_order then
    place = (made.number - transport.first_number) % transport.modulo + 1
    is_repeated = pieces[place] ~= nil and is_same(pieces[place], made.piece)
    is_wrong = packet.total > 0 and place >= packet.total
  else
    place = packet.count + 1
    local before = (transport.first_number + place - 2) % transport.modulo
    is_repeated = place > 1 and made.number == before and is_same(own, packet.latest)
    is_wrong = made.number ~= (transport.first_number + place - 1) % transport.modulo
  end
  if is_repeated then return nil, "malformed: repeated" end
  packet.frames[#packet.frames + 1], packet.latest, packet.time = frame, own, time
  if is_wrong or pieces[place] then
    local how = pieces[place] and "twice" or place == due_in(packet) and "missing" or "beyond its end"
    give_up(key, "malformed: " .. named(packet, place) .. " " .. how)
    return
  end
  pieces[place], packet.count = made.piece, packet.count + 1
  local is_last = made.is_last or (packet.total > 0 and place == packet.total - 1)
  local before, least = #packet.first + packet.room * (place - 1), 0
  if packet.size and is_last then least = packet.size - before end
  local sum = #packet.first
  for _, piece in pairs(pieces) do sum = sum + #piece end
  if #made.piece < least or (not is_last and #made.piece ~= packet.room) then
    give_up(key, "malformed: " .. named(packet, place) .. " is short")
  elseif not packet.size and sum > transport.most_bytes then
    give_up(key, "malformed: too long")
  elseif (packet.total == 0 and is_last) or (packet.total > 0 and packet.count == packet.total - 1) then
    under_way[key], count_open = nil, count_open - 1
    return joined(packet), nil, nil, packet.frames
  else
    return nil, nil, named(packet, place)
  end
end

-- What one more frame decides: a packet's bytes and its frames, or what is wrong with the frame, or which part it is.
local function taken(transport, bytes, size, source, time, frame)
  local made, reason = part_of(transport, bytes, size)
  if not made then return nil, reason end
  local key = transport.number .. "|" .. source .. "|" .. made.session
  local packet = under_way[key]
  if packet and time - packet.time > transport.timeout then
    give_up(key, why_lost(packet, "timed out"))
    packet = nil
  end
  if made.role == "next" then
    if not packet then return nil, "malformed: no first frame" end
    return continued(transport, key, packet, made, bytes, size, time, frame)
  end
  if packet then give_up(key, why_lost(packet, "restarted")) end
  if made.role == "single" then return made.piece end
  return begun(transport, key, made, bytes, size, time, frame)
end

-- A packet without the check that its transport has added, or nil where that is wrong.
local function unwrapped(transport, data, extra)
  local check = transport.check
  if not check then return data end
  if #data < check.size then return nil end
  local covered_bytes, own, rest = {}, {}, {}
  local first = check.is_in_front and 1 or #data - check.size + 1
  for at, byte in ipairs(data) do
    local place = at - first
    if place >= 0 and place < check.size then own[place] = byte else rest[#rest + 1] = byte end
  end
  if check.is_in_front then appended(covered_bytes, extra) end
  appended(covered_bytes, rest)
  return compute.crc(covered_bytes, check) == number(own, check.pieces) and rest or nil
end
