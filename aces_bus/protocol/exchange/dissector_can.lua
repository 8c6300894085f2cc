
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
      if message.extended == is_extended and message.remote == is_remote
          and (message.fd == is_fd or message.any_format) and captured(message.id, id, {}) then
        table.insert(by_key[key], message)
      end
    end
  end
  return by_key[key]
end

local function dissect(tvb, pinfo, tree, bytes, size)
  local id = last(can_id())
  if not id or last(can_error()) then return 0 end
  local messages = candidates(id, last(can_extended()) == true, last(can_remote()) == true, can_fd() ~= nil)
  if #messages == 0 then return 0 end
  local told = known[pinfo.number]
  if not told then
    local found, problem = decided(messages, bytes, size, id, tostring(last(interface()) or 0), pinfo.abs_ts, "both")
    told = { found, problem }
    known[pinfo.number] = told
  end
  pinfo.cols.protocol = P.name:upper()
  local branch = tree:add(proto, tvb:range(0, size))
  if told[1] then
    pinfo.cols.info = summary(told[1])
    branch:append_text(": " .. summary(told[1]))
    show(branch, tvb, bytes, size, told[1])
  else
    pinfo.cols.info = told[2]
    branch:append_text(": " .. told[2])
    branch:add(f_problem, tvb:range(0, size), told[2])
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
DissectorTable.get("can.subdissector"):add_for_decode_as(proto)
proto:register_heuristic("can", function(tvb, pinfo, tree)
  return proto.dissector(tvb, pinfo, tree) > 0
end)
