
-- What follows is the same in every dissector: it walks the table P above.
--
-- 1. A message is decided once, when it is first seen: what a reply answers depends on the messages before it.
-- 2. Bytes are numbers 0…255 in tables from 0 on; a number of more than 32 bits is two halves. No bit operators: they
--    differ between versions of Lua.

local floor = math.floor

local function xor(a, b)
  local result, place = 0, 1
  while a > 0 or b > 0 do
    if a % 2 ~= b % 2 then result = result + place end
    a, b, place = floor(a / 2), floor(b / 2), place * 2
  end
  return result
end

local function either(a, b) -- bitwise or, of bytes
  local result, place = 0, 1
  while a > 0 or b > 0 do
    if a % 2 + b % 2 > 0 then result = result + place end
    a, b, place = floor(a / 2), floor(b / 2), place * 2
  end
  return result
end

local function both(a, b) -- bitwise and, of bytes
  return a + b - either(a, b)
end

-- ------------------------------------------------------------------ names and preferences

local function made(name)
  return Proto(name, P.title)
end

local prefix = P.name
local is_made, proto = pcall(made, prefix)
if not is_made then -- Wireshark has a protocol of this name
  prefix = "aces_" .. P.name
  proto = made(prefix)
end

local F = {}
for number, one in ipairs(P.fields) do
  local abbr = prefix .. "." .. one[1]
  F[number] = ProtoField.new(one[2], abbr, ftypes[one[3]:upper()], one[5], one[4] and base[one[4]], nil, one[6])
end
local f_message = ProtoField.string(prefix .. ".message", "Message")
local f_problem = ProtoField.string(prefix .. ".problem", "Problem")
local f_skipped = ProtoField.bytes(prefix .. ".skipped", "Skipped")
local f_frames = ProtoField.uint32(prefix .. ".packet_frames", "Frames of this packet")
local f_whole = ProtoField.framenum(prefix .. ".packet_in", "Packet complete in", base.NONE, frametype.NONE)
for _, field in ipairs({ f_message, f_problem, f_skipped, f_frames, f_whole }) do F[#F + 1] = field end
proto.fields = F

-- ------------------------------------------------------------------ numbers

-- The number whose pieces are {byte, shift, width, place}: its lower and its upper 32 bits.
local function halves(bytes, pieces)
  local low, high = 0, 0
  for _, piece in ipairs(pieces) do
    local part = floor(bytes[piece[1]] / 2 ^ piece[2]) % 2 ^ piece[3]
    if piece[4] >= 32 then
      high = high + part * 2 ^ (piece[4] - 32)
    else
      local moved = part * 2 ^ piece[4]
      low, high = low + moved % 2 ^ 32, high + floor(moved / 2 ^ 32)
    end
  end
  return low, high
end

-- As a float; exact up to 53 bits.
local function number(bytes, pieces)
  local low, high = halves(bytes, pieces)
  return low + high * 2 ^ 32
end

local function signed(value, width)
  return value >= 2 ^ (width - 1) and value - 2 ^ width or value
end

-- IEEE 754 of 16, 32 or 64 bits.
local function float(low, high, width)
  local bits, bias, top = 52, 1023, high
  if width == 64 then
    low = low + high % 2 ^ 20 * 2 ^ 32
    top = floor(high / 2 ^ 20)
  elseif width == 32 then
    bits, bias = 23, 127
    top, low = floor(low / 2 ^ 23), low % 2 ^ 23
  else
    bits, bias = 10, 15
    top, low = floor(low / 2 ^ 10), low % 2 ^ 10
  end
  local exponents = 2 * bias + 2
  local sign = top >= exponents and -1 or 1
  local exponent = top % exponents
  if exponent == exponents - 1 then
    return low == 0 and sign * math.huge or 0 / 0
  elseif exponent == 0 then
    return sign * low * 2 ^ (1 - bias - bits)
  end
  return sign * (1 + low / 2 ^ bits) * 2 ^ (exponent - bias)
end

-- Whether a number is among {low, high, step} or a set.
local function is_among(value, values)
  if values.low then
    return value >= values.low and value <= values.high and (value - values.low) % values.step == 0
  end
  return values[value] ~= nil
end

-- ------------------------------------------------------------------ checks

local function reflected(value, width)
  local result = 0
  for _ = 1, width do
    result = result * 2 + value % 2
    value = floor(value / 2)
  end
  return result
end

local compute = {}

function compute.sum(data, check)
  local total = 0
  for _, byte in ipairs(data) do total = total + byte end
  local modulo = 256 ^ check.size
  if check.sign == "~" then return modulo - 1 - total % modulo end
  if check.sign == "-" then return -total % modulo end
  return total % modulo
end

function compute.xor(data)
  local result = 0
  for _, byte in ipairs(data) do result = xor(result, byte) end
  return result
end

function compute.fletcher(data)
  local a, b = 0, 0
  for _, byte in ipairs(data) do
    a = (a + byte) % 256
    b = (b + a) % 256
  end
  return a + 256 * b
end

function compute.crc(data, check)
  local width, top = check.width, 2 ^ (check.width - 1)
  local value = check.init
  for _, byte in ipairs(data) do
    if check.refin then byte = reflected(byte, 8) end
    for place = 7, 0, -1 do
      local is_set = (value >= top) ~= (floor(byte / 2 ^ place) % 2 == 1)
      value = value * 2 % 2 ^ width
      if is_set then value = xor(value, check.poly) end
    end
  end
  if check.refout then value = reflected(value, width) end
  return xor(value, check.xorout)
end

-- The covered bytes, from 1 on. A slice counts from the end where it is negative, as in Python.
local function covered(check, bytes, size, start, stop, id, extra)
  local data = {}
  local function run(first, last)
    for at = first, last - 1 do data[#data + 1] = bytes[at] end
  end
  if check.over == nil then
    run(start, stop)
    return data
  end
  for _, part in ipairs(check.over) do
    if part.slice then
      local first, last = part.from or 0, part.to or size
      if first < 0 then first = math.max(0, size + first) end
      if last < 0 then last = size + last end
      run(math.min(first, size), math.min(last, size))
    elseif part.id then
      local word = 0
      for place = 0, 28 do
        if floor(part.mask / 2 ^ place) % 2 == 1 then word = word + floor(id / 2 ^ place) % 2 * 2 ^ place end
      end
      for at = 0, part.id - 1 do
        local place = part.is_big and part.id - 1 - at or at
        data[#data + 1] = floor(word / 256 ^ place) % 256
      end
    elseif part.ids then
      local chosen = floor((bytes[part.at] or 0) / part.below) % part.values
      data[#data + 1] = part.ids[chosen % #part.ids + 1]
    else
      for _, byte in ipairs(part.bytes or extra) do data[#data + 1] = byte end
    end
  end
  return data
end

-- ------------------------------------------------------------------ what has been asked

local seen, asked = {}, 0
local DEPTH = 8

local function shown(value)
  return value and string.format("%d", value) or ""
end

local function who(link, values)
  local parts = {}
  for number, name in ipairs(link.shared) do parts[number] = shown(values[name]) end
  return table.concat(parts, ",")
end

local function place(request, channel, link, own)
  return request .. "|" .. channel .. "|" .. table.concat(link.shared, ",") .. "|" .. own
end

local function wanted(link, values)
  local own, every, parts = who(link, values), nil, {}
  for number, name in ipairs(link.shared) do parts[number] = shown(P.broadcast[name] or values[name]) end
  every = table.concat(parts, ",")
  return own == every and { own } or { own, every }
end

local function latest(link, channel, own, values, within, time)
  local entries = seen[place(link.request, channel, link, own)]
  while entries and #entries > 0 and entries[#entries].consumed do entries[#entries] = nil end
  local entry = entries and entries[#entries]
  if not entry or entry.answered[who(link, values)] then return nil end
  if within and time - entry.time > within then return nil end
  return entry
end

local function accepts(link, values)
  for name, allowed in pairs(link.values) do
    if values[name] == nil or not is_among(values[name], allowed) then return false end
  end
  return true
end

local function note(message, values, channel, time)
  asked = asked + 1
  local entry = { number = asked, time = time, values = values, answered = {} }
  for _, link in ipairs(message.noted) do
    local key = place(message.name, channel, link, who(link, values))
    local entries = seen[key] or {}
    seen[key] = entries
    entries[#entries + 1] = entry
    if #entries > DEPTH then table.remove(entries, 1) end
  end
end

-- Which of the fitting {message, values} the latest open request allows, and that request.
local function answered(fitting, channel, time)
  local newest
  for _, one in ipairs(fitting) do
    for _, link in ipairs(one[1].links) do
      for _, own in ipairs(wanted(link, one[2])) do
        local entry = latest(link, channel, own, one[2], one[1].within, time)
        if entry and (not newest or entry.number > newest.number) then newest = entry end
      end
    end
  end
  if not newest then return nil end
  for _, one in ipairs(fitting) do
    for _, link in ipairs(one[1].links) do
      for number, own in ipairs(wanted(link, one[2])) do
        local entry = latest(link, channel, own, one[2], one[1].within, time)
        if entry == newest and accepts(link, newest.values) then
          if number == 2 and not link.sticky then
            newest.answered[who(link, one[2])] = true
          else
            newest.consumed = not link.sticky
          end
          return one, newest.values
        end
      end
    end
  end
  return nil
end

-- ------------------------------------------------------------------ one message

-- The captured parts of a number, or nil when it does not match.
local function captured(pattern, value, values)
  local rest = value - pattern.constant
  if #pattern.parts == 1 then
    local part = pattern.parts[1]
    if rest < 0 or rest % 2 ^ part.shift ~= 0 or not is_among(rest / 2 ^ part.shift, part.values) then return false end
    values[part.name] = rest / 2 ^ part.shift
    return true
  end
  for _, part in ipairs(pattern.parts) do
    local found = floor(value / 2 ^ part.shift) % 2 ^ part.width
    if not is_among(found, part.values) then return false end
    values[part.name] = found
    rest = rest - found * 2 ^ part.shift
  end
  return rest == 0
end

local function is_there(when, values)
  return not when or (values[when[1]] ~= nil and when[2][values[when[1]]] ~= nil)
end

-- The cells of a payload that is characters, or nil.
local function cells_of(split, bytes, size)
  local text = {}
  for at = split.start, size - split.stop - 1 do text[#text + 1] = string.char(bytes[at]) end
  text = table.concat(text)
  if split.lead then
    if text == "" then return split.least == 0 and {} or nil end
    if text:sub(1, #split.separator) ~= split.separator then return nil end
    text = text:sub(#split.separator + 1)
  end
  local found, at = {}, 1
  while true do
    local first, last = text:find(split.separator, at, true)
    found[#found + 1] = { text:sub(at, (first or 0) - 1), split.start + at - 1 + (split.lead and #split.separator or 0) }
    if not first then break end
    at = last + 1
  end
  if #found < split.least or (split.most and #found > split.most) then return nil end
  return found
end

-- The raw values of a message's fields by their names, or nil and why not.
local function read(message, bytes, size, id, extra)
  local values = {}
  if message.id and not captured(message.id, id, values) then return nil end
  for _, constant in ipairs(message.constants) do
    local byte = bytes[constant[1]]
    if byte and (constant[2] == 255 and byte or both(byte, constant[2])) ~= constant[3] then return nil end
  end
  for _, one in ipairs(message.one_of) do
    if one.last < size and not is_among(number(bytes, one.pieces), one.values) then return nil end
  end
  if size < message.least or (message.lengths and not is_among(size, message.lengths)) then
    return nil, "length " .. size
  end
  for _, field in ipairs(message.fields) do
    if field.pieces and is_there(field.when, values) then
      if field.last >= size then return nil, "length " .. size end
      local value = number(bytes, field.pieces)
      if field.pattern then
        local part = field.pattern
        value = part.width and floor(value / 2 ^ part.shift) % 2 ^ part.width
          or (value - part.constant) / 2 ^ part.shift -- alone in its number
      elseif field.kind == "int" then
        value = signed(value, field.width)
      end
      values[field.path] = value
    end
  end
  if message.by then
    local length = message.by.sizes[values[message.by.selector]] or message.by.otherwise
    if size ~= length then return nil, "length " .. size end
  end
  for _, field in ipairs(message.fields) do
    if field.kind == "groups" then
      local left = size - field.tail - field.start
      local count = field.count and number(bytes, field.count) or floor(left / field.width)
      if left ~= count * field.width then return nil, "length " .. size end
    end
  end
  if message.split then
    local cells = cells_of(message.split, bytes, size)
    if not cells then return nil, "fields" end
    values[""] = cells
  end
  local check = message.check
  if check then
    local data
    if check.over then
      data = covered(check, bytes, size, 0, size, id, check.extra)
    else
      data = {}
      for at = 0, size - 1 do
        if at < check.at or at >= check.at + check.size then data[#data + 1] = bytes[at] end
      end
    end
    if compute[check.kind](data, check) ~= number(bytes, check.pieces) then return nil, "checksum" end
  end
  return values
end

-- Which of `messages`, in order of trial, some bytes are: {message, values, request}, or nil and why not.
local function decided(messages, bytes, size, id, channel, time, mode)
  local fitting, problem = {}, nil
  for _, message in ipairs(messages) do
    if message.bound[mode] then
      local values, why = read(message, bytes, size, id)
      if values then fitting[#fitting + 1] = { message, values } else problem = problem or why end
    end
  end
  local found, request
  if #fitting > 0 then found, request = answered(fitting, channel, time) end
  if not found then
    for _, message in ipairs(messages) do
      if not message.bound[mode] then
        local values, why = read(message, bytes, size, id)
        if values then
          found = { message, values }
          if message.answers[mode] then answered({ found }, channel, time) end
          break
        end
        problem = problem or why
      end
    end
  end
  if found then
    if found[1].noted then note(found[1], found[2], channel, time) end
    return { found[1], found[2], request }
  end
  if #fitting > 0 then
    local names, is_named = {}, {}
    for _, one in ipairs(fitting) do
      for _, link in ipairs(one[1].links) do
        if not is_named[link.request] then names[#names + 1] = link.request end
        is_named[link.request] = true
      end
    end
    return nil, "unknown: needs request " .. table.concat(names, "|")
  end
  return nil, problem and "malformed: " .. problem or "unknown"
end

-- ------------------------------------------------------------------ what is shown

-- A whole number as Wireshark takes it for a field of this kind.
local function whole(field, bytes)
  local low, high = halves(bytes, field.pieces)
  if field.magnitude then
    local value = low + high * 2 ^ 32
    local limit = 2 ^ (field.width - 1)
    return value >= limit and limit - value or value, nil
  end
  if field.kind == "int" and field.width > 32 then
    if field.width < 64 and high >= 2 ^ (field.width - 33) then high = high + 2 ^ 32 - 2 ^ (field.width - 32) end
    return low + signed(high, 32) * 2 ^ 32, Int64.new(low, signed(high, 32))
  elseif field.kind == "int" then
    return signed(low, field.width), nil
  elseif field.width > 32 then
    return low + high * 2 ^ 32, UInt64.new(low, high)
  end
  return low, nil
end

local function integral(value, is_signed)
  return (is_signed and Int64 or UInt64).new(value % 2 ^ 32, floor(value / 2 ^ 32))
end

local function show_number(tree, range, field, value, exact)
  local raw, item = field.raw, nil
  if field.is_wide and not exact then exact = integral(value, field.is_signed) end
  if raw then
    item = tree:add(F[field.field], range, value * field.scale + field.offset)
    if field.unit ~= "" then item:append_text(" " .. field.unit) end
    if field.names and field.names[value] then item:append_text(" (" .. field.names[value] .. ")") end
    tree = item
    tree:add(F[raw], range, exact or value)
  else
    item = tree:add(F[field.field], range, exact or value)
    if field.unit ~= "" then item:append_text(" " .. field.unit) end
    if field.names and field.is_told then
      local name = field.names[value]
      if name then item:append_text(" (" .. name .. ")") end
    end
  end
  for _, run in ipairs(field.unknown or {}) do
    if run[1] <= value and value <= run[2] then item:append_text(" [not known]") end
  end
  for _, flag in ipairs(field.flags or {}) do
    item:add(F[flag[2]], range, floor(value / 2 ^ flag[1]) % 2 == 1)
  end
end

local show_field

local function show_inside(tree, range, inside, bytes, values)
  if range:len() == 0 then return end
  local tvb = range:tvb()
  for _, field in ipairs(inside.fields) do
    if is_there(field.when, values) then
      show_field(tree, tvb, field, bytes, range:len(), { inside, values })
    end
  end
end

local function part(bytes, start, size)
  local found = {}
  for at = 0, size - 1 do found[at] = bytes[start + at] end
  return found
end

-- The items of a list up to `stop`: what cannot be read is bytes.
local function show_items(tree, tvb, list, bytes, stop)
  local at = list.start
  while at < stop do
    local left = stop - at
    local head = part(bytes, at, math.min(left, list.head))
    local tag = left >= list.head and number(head, list.tag) or nil
    local kind, length = list.kinds[tag or -1], left
    if tag and list.sizes then
      length = list.head + number(head, list.sizes) - list.counted
    elseif kind and kind.size then
      length = math.min(left, list.head + kind.size)
    end
    local is_whole = tag and length >= list.head and length <= left
    if not is_whole then length = left end
    local item = tree:add(F[list.field], tvb:range(at, length))
    if is_whole then
      local inner = part(bytes, at + list.head, length - list.head)
      local values = kind and read(kind, inner, length - list.head)
      item:append_text(" " .. (kind and kind.name or "tag " .. string.format("%d", tag)))
      if values then
        if length > list.head then
          show_inside(item, tvb:range(at + list.head, length - list.head), kind, inner, values)
        end
      elseif kind then
        item:append_text(" [malformed]")
      end
    else
      item:append_text(" [malformed]")
    end
    at = at + length
  end
end

local function show_groups(tree, tvb, list, bytes, stop)
  for at = list.start, stop - list.width, list.width do
    local range, inner = tvb:range(at, list.width), part(bytes, at, list.width)
    show_inside(tree:add(F[list.field], range), range, list.inside, inner, read(list.inside, inner, list.width) or {})
  end
end

function show_field(tree, tvb, field, bytes, size, found)
  local values, request = found[2], found[3]
  if field.kind == "identifier" then
    show_number(tree, tvb:range(0, 0), field, values[field.path])
  elseif field.kind == "request" then
    local value = request and request[field.path]
    if value and field.field then tree:add(F[field.field], tvb:range(0, 0), value):set_generated() end
  elseif field.kind == "cell" then
    local cell = values[""][field.index]
    if cell then tree:add(F[field.field], tvb:range(cell[2], #cell[1]), cell[1]) end
  elseif field.kind == "cells" then
    for index = field.index, #values[""] do
      local cell = values[""][index]
      tree:add(F[field.field], tvb:range(cell[2], #cell[1]), cell[1])
    end
  elseif field.kind == "items" then
    show_items(tree, tvb, field, bytes, size - field.tail)
  elseif field.kind == "groups" then
    show_groups(tree, tvb, field, bytes, size - field.tail)
  elseif field.kind == "bytes" or field.kind == "text" then
    local length = field.size or size - field.tail - field.start
    if length > 0 and field.start + length <= size then
      local range = tvb:range(field.start, length)
      if field.kind == "bytes" then
        tree:add(F[field.field], range)
      else
        local kept = length
        for at = 0, length - 1 do
          for _, stop in ipairs(field.ends) do
            if bytes[field.start + at] == stop then kept = math.min(kept, at) end
          end
        end
        tree:add(F[field.field], range, kept > 0 and tvb:range(field.start, kept):string() or "")
      end
    end
  elseif field.kind == "rest" then
    local part, low, high = field.always, 0, 0
    local sets = { part }
    for _, one in ipairs(field.more) do sets[#sets + 1] = one[2][values[one[1]]] end
    for at = 0, field.size - 1 do
      local mask = 0
      for _, set in pairs(sets) do mask = either(mask, set[at + 1]) end
      local byte = both(bytes[field.start + at], 255 - mask)
      if at < 4 then low = low + byte * 256 ^ at else high = high + byte * 256 ^ (at - 4) end
    end
    tree:add(F[field.field], tvb:range(field.start, field.size), UInt64.new(low, high))
  else
    local range = tvb:range(field.first, field.last - field.first + 1)
    if field.kind == "float" then
      local low, high = halves(bytes, field.pieces)
      show_number(tree, range, field, float(low, high, field.width))
    elseif field.pattern then
      show_number(tree, range, field, values[field.path])
    else
      show_number(tree, range, field, whole(field, bytes))
    end
  end
end

local function show(tree, tvb, bytes, size, found)
  local message = found[1]
  tree:add(f_message, tvb:range(0, size), message.name):set_text("Message: " .. message.name)
  for _, field in ipairs(message.fields) do
    if is_there(field.when, found[2]) then show_field(tree, tvb, field, bytes, size, found) end
  end
end

local function summary(found)
  local text = found[1].name
  for _, field in ipairs(found[1].fields) do
    if field.is_outer and found[2][field.path] then
      text = text .. " " .. field.path .. "=" .. string.format("%d", found[2][field.path])
    end
  end
  return text
end

local function bytes_of(tvb)
  local bytes, array = {}, tvb:bytes()
  for at = 0, array:len() - 1 do bytes[at] = array:get_index(at) end
  return bytes, array:len()
end

-- pinfo.number → what its messages are, in order; packets under way, how many were begun and are open. Forgotten with the
-- capture.
local known = {}
local under_way, opened, count_open = {}, 0, 0

function proto.init()
  seen, asked, known = {}, 0, {}
  under_way, opened, count_open = {}, 0, 0
end
