-- The requests of load.sh, for wrk. In the environment: LOAD (small, json,
-- mixed), SCENE, DOCUMENT (a file), POINTS (a file of raw float32), and perhaps
-- BLOBFIELD_TOKEN.

local scene = "/v1/scenes/" .. os.getenv("SCENE")
local json = { ["Content-Type"] = "application/json" }
local octets = {
	["Content-Type"] = "application/octet-stream",
	["Accept"] = "application/octet-stream",
}
local plain = {}
local token = os.getenv("BLOBFIELD_TOKEN")

if token and token ~= "" then
	for _, headers in ipairs({ json, octets, plain }) do
		headers["Authorization"] = "Bearer " .. token
	end
end

local function read(path)
	local file = assert(io.open(path, "rb"))
	local text = file:read("*a")

	file:close()
	return text
end

local points = read(os.getenv("POINTS"))
local document = read(os.getenv("DOCUMENT"))

local function small_json()
	local list = {}

	for i = 1, 16 do
		list[i] = string.format("[%.3f,0,%.3f]", i / 16, i / 8)
	end
	return '{"points":[' .. table.concat(list, ",") .. "]}"
end

-- { share, method, path, headers, body }: how many of how many.
local loads = {
	small = { { 1, "POST", scene .. "/eval", octets, points } },
	json = { { 1, "POST", scene .. "/eval", json, small_json() } },
	mixed = {
		{ 40, "POST", scene .. "/eval", octets, points },
		{ 20, "POST", scene .. "/eval", json, small_json() },
		{ 10, "POST", scene .. "/raycast", json,
			'{"rays":[[0,-5,2.5,0,1,0],[0.2,-5,0.8,0,1,0]]}' },
		{ 10, "POST", scene .. "/project", json,
			'{"points":[[0.5,0.25,1.4]]}' },
		{ 5, "GET", scene .. "/bounds", plain, nil },
		{ 5, "GET", scene, plain, nil },
		{ 5, "PUT", scene, json, document },
		{ 2, "POST", scene .. "/slice", json,
			'{"width":64,"height":64}' },
		{ 2, "POST", scene .. "/mesh", json, '{"resolution":16}' },
		{ 1, "POST", scene .. "/render", json,
			'{"width":48,"height":32,"samples":1}' },
	},
}

local requests = {}
local count = 0
local threads = {}

function setup(thread)
	threads[#threads + 1] = thread
	thread:set("seed", #threads)
end

function init()
	for _, r in ipairs(loads[os.getenv("LOAD")]) do
		local made = wrk.format(r[2], r[3], r[4], r[5])

		for _ = 1, r[1] do
			requests[#requests + 1] = made
		end
	end
	math.randomseed(seed)
	succeeded, refused, others = 0, 0, 0
end

function request()
	return requests[math.random(#requests)]
end

-- A full queue is an answer, too, but no success.
function response(status)
	if status >= 200 and status < 300 then
		succeeded = succeeded + 1
	elseif status == 503 then
		refused = refused + 1
	else
		others = others + 1
	end
end

function done()
	local sum = { succeeded = 0, refused = 0, others = 0 }

	for _, thread in ipairs(threads) do
		for name in pairs(sum) do
			sum[name] = sum[name] + thread:get(name)
		end
	end
	print("requests that succeeded: " .. sum.succeeded)
	print("that the daemon had no room for (503): " .. sum.refused)
	print("that failed: " .. sum.others)
end
